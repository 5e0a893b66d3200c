//! Structure from motion by COLMAP, driven as a subprocess.
