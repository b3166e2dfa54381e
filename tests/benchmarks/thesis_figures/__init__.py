"""The drawings of figures.py: sensors (chapter 4), integration and drive (chapter 6), rotations (section 2.2.4)."""
