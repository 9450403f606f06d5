"""What a robot makes of its depth camera's pictures (ch. 3): a beta-VAE's latents, a prediction of the next ones.

Networks and their training on arrays. Who records the pictures, and who acts on latents, is `demonstrations`'.
"""

SHIPPED_ENCODER = "home/depth_encoder"
SHIPPED_PREDICTOR = "home/depth_predictor"
