"""The process: depth images and robot states in, heightmaps out."""
