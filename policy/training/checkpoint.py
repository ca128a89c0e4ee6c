"""The checkpoint of a training: everything that is needed to resume it, or to export its policy."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import torch
from torch import nn

from saltus.config import from_toml
from saltus.errors import ConfigError, ModelError, SaltusError
from saltus.files import atomic_write, check_archive
from saltus.model_file import ModelFile
from saltus.onnx_export import weights_of
from saltus.policy.env.settings import JumpTrainSettings

if TYPE_CHECKING:
    from rsl_rl.models import MLPModel

Config = TypeVar("Config")

NETWORK = "network."
"""Begins the names of an exported actor's weights in its file."""
_MEAN, _STD, _VARIANCE, _COUNT = (
    f"obs_normalizer.{name}" for name in ("_mean", "_std", "_var", "count")
)

NEEDED = {
    "actor_state_dict", "critic_state_dict", "optimizer_state_dict", "kind", "level",
    "config", "commit", "iteration", "steps", "seconds",
}  # fmt: skip


def write_checkpoint(path: Path, state: dict[str, object]) -> None:
    """Writes a checkpoint, whole or not at all; `SaltusError` where there is no room for it."""
    try:
        with atomic_write(path) as partial:
            torch.save(state, partial)
    except (OSError, RuntimeError) as error:  # torch says RuntimeError where a disk is full
        raise SaltusError(f"cannot write {path}: {str(error).splitlines()[0]}") from error


def read_policy_checkpoint(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Reads what `Learner.save` wrote; `SaltusError` where the file is missing,
    damaged, or none of a motion policy.
    """
    try:
        check_archive(path, checksums=True)  # torch loads flipped weights without complaint
        state = torch.load(path, map_location=device, weights_only=True)
    except OSError as error:
        raise SaltusError(
            f"cannot read checkpoint {path}: {error.strerror or 'it is damaged'}"
        ) from error
    except Exception as error:  # unpickling another kind of file raises anything
        raise SaltusError(f"{path} is no checkpoint: torch cannot read it") from error
    if not isinstance(state, dict) or not state.keys() >= NEEDED:
        raise SaltusError(f"{path} is no checkpoint of a motion policy")
    return state


@overload
def training_config(state: Mapping[str, Any]) -> JumpTrainSettings: ...
@overload
def training_config(state: Mapping[str, Any], kind: type[Config]) -> Config: ...
def training_config(state: Mapping[str, Any], kind: type[Any] = JumpTrainSettings) -> Any:
    """The configuration of a training, from what its checkpoint holds;
    `SaltusError` if it is another program's.
    """
    try:
        return from_toml(kind, state["config"])
    except ConfigError as error:
        raise SaltusError(
            f"the checkpoint's configuration does not fit this program: {error}"
        ) from error


def deployed_network(actor: "MLPModel", checkpoint: Mapping[str, Any]) -> nn.Module:
    """The mean of an actor with the weights of a checkpoint, as it is exported.

    Raises:
        SaltusError: the checkpoint's network has another size.
    """
    try:
        actor.load_state_dict(checkpoint["actor_state_dict"])
    except RuntimeError as error:
        raise SaltusError(
            "the checkpoint's network does not fit this program: train the policy again"
        ) from error
    network: nn.Module = actor.as_onnx(verbose=False).eval()
    return network


def exported_actor(actor: "MLPModel", file: ModelFile) -> dict[str, torch.Tensor]:
    """State of an actor from the ONNX file of its `deployed_network`: weights, normalisation and
    how many observations that counts; the standard deviations, which no file has, of `actor`.

    Raises:
        ModelError: the file holds another network.
    """
    known, values = actor.state_dict(), weights_of(file)
    named = {
        name.removeprefix(NETWORK): value
        for name, value in values.items()
        if name.startswith(NETWORK)
    }
    divisors = [value for name, value in values.items() if not name.startswith(NETWORK)]
    needed = {_MEAN, *(name for name in known if name.startswith("mlp."))}
    if (
        not needed <= named.keys()
        or len(divisors) != 1
        or any(named[name].shape != known[name].shape for name in needed)
    ):
        raise ModelError(
            f"{file.path} holds another network than this program exports: name its checkpoint"
        )
    std = divisors[0] - actor.obs_normalizer.eps
    count = torch.tensor(int(file.field("steps")))
    return known | named | {_STD: std, _VARIANCE: std.square(), _COUNT: count}
