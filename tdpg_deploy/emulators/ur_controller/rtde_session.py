"""One RTDE client's conversation with the controller: packages in, packages out. No sockets."""

from __future__ import annotations

import struct

from tdpg_deploy.emulators.ur_controller import rtde_wire as wire
from tdpg_deploy.emulators.ur_controller import variables
from tdpg_deploy.emulators.ur_controller.controller import Controller
from tdpg_deploy.emulators.ur_controller.rtde_wire import Kind, Package, Recipe


class Claims:
    """Which session writes which input variable: one writer each."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}

    def is_free(self, name: str, owner: object) -> bool:
        return self._owners.get(name, owner) is owner

    def take(self, names: tuple[str, ...], owner: object) -> None:
        self._owners.update(dict.fromkeys(names, owner))

    def release(self, owner: object) -> None:
        self._owners = {n: o for n, o in self._owners.items() if o is not owner}


class RtdeSession:
    """Answers requests, and gives a data package when one is due."""

    def __init__(self, controller: Controller, claims: Claims) -> None:
        self._controller, self._claims = controller, claims
        self._inputs: dict[int, Recipe] = {}
        self._outputs: Recipe | None = None
        self._readers: list[variables.Read] = []
        self._period = 0.0
        self._due = 0.0
        self._started = False

    def close(self) -> None:
        self._claims.release(self)

    def answer(self, package: Package) -> bytes:
        """The reply, or nothing for data. Raises WireError on nonsense."""
        if package.kind == Kind.REQUEST_PROTOCOL_VERSION:
            supported = package.payload == struct.pack(">H", wire.PROTOCOL_VERSION)
            return wire.accepted(Kind.REQUEST_PROTOCOL_VERSION, ok=supported)
        if package.kind == Kind.GET_CONTROLLER_VERSION:
            return wire.controller_version(self._controller.generation.version)
        if package.kind == Kind.SETUP_OUTPUTS:
            return self._set_up_outputs(*wire.parse_output_setup(package.payload))
        if package.kind == Kind.SETUP_INPUTS:
            return self._set_up_inputs(wire.parse_names(package.payload))
        if package.kind in (Kind.START, Kind.PAUSE):
            self._started = package.kind == Kind.START and self._outputs is not None
            ok = self._started or package.kind == Kind.PAUSE
            return wire.accepted(Kind(package.kind), ok=ok)
        if package.kind == Kind.DATA:
            self._take(package.payload)
            return b""
        raise wire.WireError(f"package of unknown type {package.kind}")

    def due(self) -> bytes:
        """A data package when the client's period has passed, else nothing."""
        if not self._started or self._outputs is None or self._controller.time < self._due:
            return b""
        self._due = max(self._due + self._period, self._controller.time)
        return self._outputs.pack([read(self._controller) for read in self._readers])

    def _set_up_outputs(self, rate: float, names: tuple[str, ...]) -> bytes:
        major = self._controller.generation.version[0]
        found = [variables.output(name, major) for name in names]
        types = [entry[0].name if entry else "NOT_FOUND" for entry in found]
        known = [entry for entry in found if entry]
        if not 0 < rate <= self._controller.generation.frequency or len(known) < len(names):
            return wire.recipe_reply(Kind.SETUP_OUTPUTS, 0, types)
        # Half a cycle early, since the controller's time is a sum of rounded periods.
        self._period, self._due = 1 / rate, self._controller.time - self._controller.dt / 2
        self._outputs = Recipe(id=1, names=names, types=tuple(kind for kind, _ in known))
        self._readers = [read for _, read in known]
        return wire.recipe_reply(Kind.SETUP_OUTPUTS, 1, types)

    def _set_up_inputs(self, names: tuple[str, ...]) -> bytes:
        kinds = [variables.input_type(name) for name in names]
        known = tuple(kind for kind in kinds if kind)
        if len(known) < len(names):
            types = [kind.name if kind else "NOT_FOUND" for kind in kinds]
            return wire.recipe_reply(Kind.SETUP_INPUTS, 0, types)
        free = [self._is_free(name) for name in names]
        if not all(free):
            types = [k.name if ok else "IN_USE" for k, ok in zip(known, free, strict=True)]
            return wire.recipe_reply(Kind.SETUP_INPUTS, 0, types)
        self._claims.take(names, self)
        recipe = Recipe(id=len(self._inputs) + 1, names=names, types=known)
        self._inputs[recipe.id] = recipe
        return wire.recipe_reply(Kind.SETUP_INPUTS, recipe.id, [kind.name for kind in known])

    def _is_free(self, name: str) -> bool:
        return name not in self._controller.claimed_by_fieldbus and self._claims.is_free(name, self)

    def _take(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            raise wire.WireError(f"data for a recipe that was not set up: {payload[:1]!r}")
        self._controller.write_inputs(recipe.unpack(payload))
