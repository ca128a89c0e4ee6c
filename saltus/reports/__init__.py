"""Reports: what all pages look like, and the figures that several of them share."""
