"""Masks of objects from a person's strokes on one photo or a few.

`propagation.make_masks` is the entry: GrabCut (Rother et al. 2004) cuts the object out of the photo
with the strokes; what that mask says of the model's Gaussians, or of the sparse points, seeds
GrabCut in the next photo; then all masks vote on each, until the photos agree.
"""
