"""The alignments, one file each: parameters, and parameters in, an aligned policy with what its card says out."""
