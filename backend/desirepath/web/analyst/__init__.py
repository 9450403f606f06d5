"""The analysts' pages: jobs, snapshots, policies, comparisons, flow fields, drawn paths."""
