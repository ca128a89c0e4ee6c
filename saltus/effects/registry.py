"""Every effect that Saltus knows, by the name under which logs, profiles and reports speak of it."""

from saltus.effects.camera import CameraChain, ViewChain
from saltus.effects.chain import ActuatorChain, BodyChain, ImuChain
from saltus.effects.effect import Effect
from saltus.effects.heightmap_shift import HeightmapShift

_ORDERS = (ActuatorChain.order, CameraChain.order, ViewChain.order, (HeightmapShift,), BodyChain.order, ImuChain.order)
EFFECTS: dict[str, type[Effect]] = {kind.name: kind for order in _ORDERS for kind in order}
