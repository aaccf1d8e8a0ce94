"""Classes of other libraries, on RayNest."""
