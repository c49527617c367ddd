"""A trained network that decides: `Decider` on frozen weights."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import numpy.typing as npt
import torch

from policies.coordinator import coordinated
from policies.critics import critic_one, critic_two
from policies.decide import best_grasps, best_push, decided
from policies.errors import NoActionError
from policies.heightmap import Heightmap
from policies.masks import allowed
from policies.methods import Method
from policies.networks.build import for_inference
from policies.networks.coordinated import CoordinatedNet
from policies.networks.maps import Network
from policies.policy import Choice, CriticVerdict, Decision, QMaps
from policies.primitives import Primitive
from policies.state import encode


class LearnedPolicy:
    """Critic I, and Critic II where the method has it, on one frozen network.

    The network is copied, so training may go on. The same heightmap, generator state and
    machine give the same decision to the bit. Threads are torch's: `torch.set_num_threads`.
    """

    def __init__(
        self, network: Network, method: Method, *, goal: bool, dtype: torch.dtype | None = None
    ) -> None:
        """goal: the network reads the goal mask. dtype: bfloat16 or float32; by default what
        this processor is fastest at. Raises ValueError: the method's rule is to be the network's
        coordinator, and it has none."""
        if method.choose is None and not isinstance(network, CoordinatedNet):
            raise ValueError(f"method {method.name} needs a network with a coordinator")
        self.method = method
        self.goal = goal
        self._dtype = dtype or fastest_dtype()
        self._network = for_inference(network, self._dtype)
        self._last: tuple[Heightmap, QMaps, torch.Tensor] | None = None

    @torch.inference_mode()
    def decide(
        self, heightmap: Heightmap, rng: np.random.Generator, *, avoid: Sequence[Primitive] = ()
    ) -> Decision:
        seconds: dict[str, float] = {}
        with _timed(seconds, "critic_one"):
            maps, _ = self._valued(heightmap)
        with _timed(seconds, "choose"):
            maps = allowed(
                maps,
                heightmap,
                avoid,
                promising=self.method.promising,
                wedged=self.method.wedged,
            )
            sure = maps.sure if self.method.sure_first else None
            grasps = best_grasps(
                maps, rng, goal=heightmap.goal, sure=sure, count=self.method.considered
            )
            push = best_push(maps, rng)
            if heightmap.goal is not None and push is not None and push.q >= self.method.push_from:
                grasps = tuple(grasp for grasp in grasps if heightmap.goal[grasp.row, grasp.col])
            if self.method.choose is not None:
                chosen = self.method.choose(grasps, push, heightmap)
            else:
                assert isinstance(self._network, CoordinatedNet)
                chosen = coordinated(self._network.coordinator, grasps, push, heightmap, avoid)
        if chosen is None:
            raise NoActionError(
                f"{self.method.name}: no action is allowed: nothing rises above the table, "
                f"it was not seen, or all was to be avoided ({len(avoid)} actions)"
            )
        verdict = None
        judge = self.method.judge_of(heightmap)
        if judge is not None and grasps:
            with _timed(seconds, "critic_two"):
                p_success = self.p_success(heightmap, grasps)
                agreed = judge(chosen, grasps, push, p_success)
            verdict = CriticVerdict(
                p_success=tuple(p_success.tolist()), overruled=agreed.kind != chosen.kind
            )
            chosen = agreed
        return decided(chosen, heightmap, maps, verdict=verdict, considered=grasps, seconds=seconds)

    @torch.inference_mode()
    def p_success(self, heightmap: Heightmap, grasps: Sequence[Choice]) -> npt.NDArray[np.float64]:
        """What Critic II gives any grasps, (n,)."""
        _, features = self._valued(heightmap)
        return critic_two(self._network, features, grasps)

    def _valued(self, heightmap: Heightmap) -> tuple[QMaps, torch.Tensor]:
        """Critic I's maps and features. The last ones are kept: when a plan is refused, the same
        heightmap is decided on again."""
        if self._last is None or self._last[0] is not heightmap:
            state = encode(heightmap, goal=self.goal).to(self._dtype)
            maps, features = critic_one(self._network, state, pushes=self.method.pushes)
            self._last = heightmap, maps, features
        return self._last[1:]


@contextmanager
def _timed(seconds: dict[str, float], part: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[part] = time.perf_counter() - start


def fastest_dtype() -> torch.dtype:
    """bfloat16 where the processor multiplies it natively (about twice as fast), else float32."""
    native = torch.cpu._is_avx512_bf16_supported()
    return torch.bfloat16 if native else torch.float32
