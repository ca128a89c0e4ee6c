"""Episodes to train on: how they are made, and how they are kept."""
