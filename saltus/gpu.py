"""The device on which thousands of robots are trained and run: a GPU, if there is one."""


def has_gpu() -> bool:
    """True where this computer has a GPU that torch can use."""
    import torch

    return torch.cuda.is_available()
