"""The 3D stage: scenes to viser's nodes, cameras, the pen, playback in the browser (`client`).

Reads no table and knows no study: what to show comes as scenes and trajectories, from `desirepath.web.stage`.
"""
