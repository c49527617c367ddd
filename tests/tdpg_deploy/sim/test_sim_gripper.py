from __future__ import annotations

import numpy as np
import pybullet
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from small_cells import (
    CARRIERS,
    MOCK,
    TABLE,
    cell,
    heap,
    lying,
    pointing_down,
    running,
    touch,
    travel,
)

from policies.gripper import OPEN_GRIPPER, OPEN_WIDTH, PAD_WIDTH
from tdpg_deploy.errors import DeviceTimeout, GripperError
from tdpg_deploy.geometry import Transform
from tdpg_deploy.hal import Holding
from tdpg_deploy.sim.arm import SimArm
from tdpg_deploy.sim.bodies import SHAPES, Shape, box
from tdpg_deploy.sim.gripper import SimGripper
from tdpg_deploy.sim.links import TIP_CLOSED, gripper_links, tip_retreat
from tdpg_deploy.sim.physics import GRAVITY, PAD_FRICTION
from tdpg_deploy.sim.scenes import Scene, SceneObject
from tdpg_deploy.sim.world import Where, World


def reach(arm: SimArm, gripper: SimGripper, x: float, y: float, height: float, yaw: float) -> float:
    """Grasp at this height of the tool, lift by 20 cm. Returns the width after the lift."""
    gripper.move(0.085, speed=0.15, force=20)
    travel(arm, pointing_down(x, y, 0.2, yaw))
    touch(arm, pointing_down(x, y, height, yaw))
    gripper.move(0, speed=0.15, force=20)
    travel(arm, pointing_down(x, y, height + 0.2, yaw))
    return gripper.state().width


@pytest.mark.parametrize("carrier", CARRIERS)
@pytest.mark.parametrize("name", SHAPES)
def test_a_block_is_lifted_by_friction_and_let_go_into_the_bin(carrier: str, name: str) -> None:
    shape = SHAPES[name]
    size = np.ptp(shape.vertices, axis=0)
    with running(carrier, lying(name)) as (world, arm, gripper):
        height = max(size[2] - 0.04, 0.006)
        width = reach(arm, gripper, 0.5, 0.0, height, np.pi / 2)
        assert_allclose(width, size[1], atol=0.002)  # the pads close along y
        assert gripper.state().holding is Holding.OBJECT
        (held,) = world.objects()
        assert_allclose(held.X_base_object.translation[2] - TABLE, 0.2 + size[2] / 2, atol=0.02)

        x, y, z = MOCK.bin.position
        travel(arm, pointing_down(x, y, z - TABLE))
        gripper.move(0.085, speed=0.15, force=20)
        world.clock.sleep(0.6)
        (delivered,) = world.objects()
        assert delivered.where is Where.BIN
        assert world.scene().objects == ()


@pytest.mark.parametrize("carrier", CARRIERS)
def test_closing_on_nothing(carrier: str) -> None:
    with running(carrier) as (world, _, gripper):
        began = world.clock.now()
        state = gripper.move(0, speed=0.1, force=20)
        assert_allclose(state.width, 0, atol=0.001)
        assert state.holding is Holding.NOTHING
        assert_allclose(world.clock.now() - began, 0.085 / 0.1, atol=0.05)
        assert_allclose(gripper.move(0.04, speed=0.1, force=20).width, 0.04, atol=0.001)
        assert_allclose(gripper.move(1.0, speed=0.1, force=20).width, 0.085, atol=0.001)


def test_fingers_that_lose_their_object_close_further() -> None:
    with running("gantry", lying("cube")) as (world, arm, gripper):
        travel(arm, pointing_down(0.5, 0, 0.2))
        touch(arm, pointing_down(0.5, 0, 0.012))
        assert gripper.move(0, speed=0.15, force=10).holding is Holding.OBJECT
        pybullet.resetBasePositionAndOrientation(
            world.bodies[0], (0.5, 0.15, TABLE + 0.03), (0, 0, 0, 1), physicsClientId=world.client
        )
        world.clock.sleep(0.3)
        assert gripper.state().holding is Holding.NOTHING
        assert gripper.state().width < 0.002


def test_both_fingers_move_alike() -> None:
    """A cube off the middle is pushed to the middle, not gripped where it lies."""
    with running("gantry", lying("cube", 0.508)) as (world, arm, gripper):
        width = reach(arm, gripper, 0.5, 0.0, 0.012, 0.0)
        assert_allclose(width, 0.05, atol=0.002)
        assert_allclose(world.objects()[0].X_base_object.translation[0], 0.5, atol=0.002)


@pytest.mark.parametrize(("share", "holds"), [(0.8, True), (1.25, False)])
def test_pads_resist_turning_up_to_a_soft_fingers_torque(share: float, holds: bool) -> None:
    """A lever held at two points: 2 x .6 x friction x force x 4 mm is all that they can bear."""
    tips = 0.02 * np.vstack([np.eye(3), -np.eye(3)])
    lever = Shape.from_hulls("lever", [tips, box(0.06, 0.01, 0.01, center=(0.05, 0, 0))])
    middle = lever.pieces[0].vertices.mean(axis=0)  # of the two points, seen from the mass
    friction, force = 0.6, 20.0
    limit = 2 * 0.6 * PAD_FRICTION * friction * force * 0.004
    mass = share * limit / (GRAVITY * -middle[0])
    simulation = {"friction": friction, "density": mass / lever.volume}
    gantry = cell("gantry")
    config = gantry.model_copy(
        update={"simulation": gantry.simulation.model_copy(update=simulation)}
    )
    start = Transform(Rotation.identity(), np.array([0.5, 0.0, TABLE + 0.05]))
    item = SceneObject(shape=lever, X_base_object=start, rgb=(0, 0, 0))
    world = World(config, Scene(objects=(item,)), seed=0)
    arm, gripper = SimArm(world), SimGripper(world)
    gripper.activate()
    travel(arm, pointing_down(0.5, 0, 0.2, np.pi / 2))
    tool = pointing_down(0.5, 0, 0.2 + 0.01).translation  # the pads' middle
    pybullet.changeDynamics(
        world.bodies[0],
        -1,
        activationState=pybullet.ACTIVATION_STATE_WAKE_UP,
        physicsClientId=world.client,
    )
    pybullet.setGravity(0, 0, 0, physicsClientId=world.client)  # of what is awake
    pybullet.resetBasePositionAndOrientation(
        world.bodies[0], (tool - middle).tolist(), (0, 0, 0, 1), physicsClientId=world.client
    )
    gripper.move(0, speed=0.15, force=force)
    pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=world.client)
    world.clock.sleep(1.0)
    (held,) = world.objects()
    world.close()
    drop = -np.degrees(np.arcsin(held.X_base_object.rotation.as_matrix()[2, 0]))
    assert (drop < 2) == holds


def test_masks_and_plans_know_the_whole_simulated_gripper() -> None:
    """policies/gripper.py has the sizes that sim/links.py builds, and something to spare."""
    palm, _, finger, _ = gripper_links(0, Transform.identity())
    tips, bars, body = OPEN_GRIPPER
    open_by = np.array([OPEN_WIDTH / 2, 0, -tip_retreat(OPEN_WIDTH)])
    for part, piece in zip((tips, bars), finger.pieces, strict=True):
        low, high = (limit(piece.vertices + open_by, axis=0) for limit in (np.min, np.max))
        assert (part.apart - part.along) / 2 <= low[0] + 1e-9
        assert (part.apart + part.along) / 2 >= high[0]
        assert part.across / 2 >= high[1]
        assert part.rise <= -high[2] + 1e-9
    assert_allclose(np.ptp(finger.pieces[0].vertices[:, 1]), PAD_WIDTH)
    for piece in palm.pieces:
        high = np.abs(piece.vertices).max(axis=0)
        assert body.along / 2 >= high[0]
        assert body.rise <= TIP_CLOSED - high[2]
        if piece is not palm.pieces[0]:  # the round foot is 5 mm broader, 50 mm higher up
            assert body.across / 2 >= high[1]


def test_speed_and_force_are_clamped() -> None:
    with running("gantry") as (world, _, gripper):
        began = world.clock.now()
        gripper.move(0, speed=5, force=1000)
        assert_allclose(world.clock.now() - began, 0.085 / 0.15, atol=0.05)


def test_needs_activation() -> None:
    world = World(cell("gantry"), Scene(objects=()), seed=0)
    with pytest.raises(GripperError, match="not activated"):
        SimGripper(world).move(0, speed=0.1, force=20)
    world.close()


def test_deadline() -> None:
    with running("gantry") as (world, _, gripper):
        began = world.clock.now()
        with pytest.raises(DeviceTimeout, match=r"after 0.2 s"):
            gripper.move(0, speed=0.1, force=20, deadline=0.2)
        assert world.clock.now() - began < 0.25


@pytest.mark.slow
def test_gantry_and_arm_agree_on_what_a_grasp_brings() -> None:
    """Same heaps, same grasps, some of them on edges and neighbours."""
    outcomes: dict[str, list[bool]] = {carrier: [] for carrier in CARRIERS}
    for seed in range(4):
        settled = World(cell("gantry"), heap(10, seed), seed=seed)
        scene = settled.scene()
        settled.close()
        for target, yaw in ((0, 0.2), (4, 1.8), (9, 2.9)):
            x, y, z = scene.objects[target].X_base_object.translation
            for carrier in CARRIERS:
                world = World(cell(carrier), scene, seed=seed)
                arm, gripper = SimArm(world), SimGripper(world)
                gripper.activate()
                width = reach(arm, gripper, x, y, max(z - TABLE - 0.01, 0.006), yaw)
                outcomes[carrier].append(width > 0.004)
                world.close()
    gantry, ur5 = (np.array(outcomes[carrier]) for carrier in CARRIERS)
    assert (gantry == ur5).mean() >= 0.9  # 12 grasps: at most one differs
    assert gantry.any()
    assert not gantry.all()
