"""Structure from motion, offline by pycolmap (the role VisualSFM has in the thesis), fed online. docs/slam.md."""
