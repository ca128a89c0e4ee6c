"""The heightmap process: answers every state of every robot with a heightmap,
and takes in new models.
"""

import time
from collections.abc import Callable, Sequence

from saltus.errors import ModelError
from saltus.heightmap.service.fleet import FleetService
from saltus.heightmap.service.model_inbox import FILE, ModelInbox
from saltus.heightmap.service.network import HeightmapNetwork
from saltus.heightmap.service.robot_inbox import RobotInbox
from saltus.heightmap.service.scan_fleet import ScanChoice, ScanFleet
from saltus.heightmap.service.true_fleet import TrueFleet
from saltus.runtime.process import STATUS_PERIOD_S, ProcessContext
from saltus.used_networks import model_path

WAIT_S = 0.1
"""At most, for messages: proof of life, a new model and the wish to stop want to be looked after
without any."""
REFUSED = "model/refused"
"""Name under which refused models are counted, beside refused messages."""


class HeightmapProcess:
    """Wires the service to buses and clocks, one for each robot; the buses share one bell.

    Configuration and folder are those of the first. A model that is put into the folder
    (`saltus.heightmap.service.model_inbox`) replaces the one in use, in real time only: a lockstep
    run must repeat. With a `scan` its grid is served in place of the line, by the network of any
    grid, which is not replaced; a run whose model is such a network has its own grid served by it.
    A run on true heights has them from the simulator's truth.
    """

    def __init__(self, contexts: Sequence[ProcessContext], scan: ScanChoice | None = None) -> None:
        first = contexts[0]
        setup, self._bus, depth = first.setup, first.bus, first.setup.profile.depth_topic
        self._lockstep = first.config.pace == "lockstep"
        self._next_look_s = 0.0
        self._told = (0, 0)
        self._inbox: ModelInbox | None = None
        names = [context.bus.prefix for context in contexts]
        is_true = scan is None and first.config.heights == "true"
        model, planner = first.config.heightmap_model, first.config.planner
        scan = scan or ScanChoice.of_run(setup.grid, model, planner)
        cameras: list[str] = []
        if is_true:
            self._fleet: FleetService | ScanFleet | TrueFleet = TrueFleet(contexts)
        elif scan is not None:
            rig = scan.rig(setup.robot, setup.camera)
            self._fleet = ScanFleet(scan.network(), rig, names, depth, at_once=self._lockstep)
            cameras = [camera for camera in rig.cameras if camera]
        else:
            path = model_path("heightmap", model)
            network = HeightmapNetwork(setup.robot, path, setup.grid)
            self._fleet = FleetService(network, names, depth)
            self._inbox = ModelInbox(setup.robot, setup.grid, first.run_dir / FILE)
        self._links = {
            context.bus.prefix: RobotInbox(context, depth, cameras) for context in contexts
        }

    def run(self, stopped: Callable[[], bool]) -> None:
        """Answers until it is told to stop. Without robot states it only shows that it is alive."""
        while not (stopped() or any(link.context.stopped for link in self._links.values())):
            for link in self._links.values():
                link.context.beat(ticks=link.ticks)
            if self._inbox is not None and not self._lockstep and not self._bus.muted:
                self._look_for_model(self._inbox)
            heard = self._bus.bell.rings
            if not self._answer():
                self._bus.bell.wait(heard, WAIT_S)
        for part in (self._inbox, self._fleet):
            if isinstance(part, ModelInbox | ScanFleet):
                part.close()

    def _answer(self) -> bool:
        """Answers whoever asks; returns whether anybody did."""
        arrivals = {}
        for name, link in self._links.items():
            arrival = link.take()
            if arrival is not None:
                arrivals[name] = arrival
        # The sums of a batch differ in their last bit from those of one robot: in lockstep nobody's
        # answer may depend on who else asks at the same moment.
        batches = (
            [{name: arrival} for name, arrival in arrivals.items()]
            if self._lockstep
            else [arrivals]
        )
        for batch in batches:
            for name, heightmap in self._fleet.step(batch).items():
                self._links[name].answer(heightmap)
        return bool(arrivals)

    def _look_for_model(self, inbox: ModelInbox) -> None:
        """Twice a second: whether a model was given, and what became of the last one."""
        if time.monotonic() < self._next_look_s:
            return
        self._next_look_s = time.monotonic() + STATUS_PERIOD_S
        try:
            network = inbox.poll()
        except ModelError as error:
            self._tell("model_refused", str(error), refused=True)
            return
        assert isinstance(self._fleet, FleetService)  # noqa: S101 - it alone has an inbox
        if network is not None:
            self._fleet.use(network)
            self._tell("model_accepted", f"model {network.model_id} warms up")
        swaps, given_up = self._fleet.swaps, self._fleet.given_up
        if swaps > self._told[0]:
            self._tell("model_swapped", f"{swaps} of this service so far")
        if given_up > self._told[1]:
            self._tell(
                "model_refused",
                "its answers did not become as good as those of the one in use",
                refused=True,
            )
        self._told = swaps, given_up

    def _tell(self, code: str, detail: str, *, refused: bool = False) -> None:
        for link in self._links.values():
            if refused:
                link.context.bus.rejected[REFUSED] += 1
            link.context.event(code, detail)
