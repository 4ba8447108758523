"""The controls of the page: time, who drives, joints and tool, the person, and what is shown.

Callbacks come on threads of their own: they only tell ``Page.ask`` what the page's loop shall do.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import viser

from agym_jax.human.population import IMPAIRMENTS
from agym_jax.viewer.drive import JOINTS, TOOL, ToolGoal
from agym_jax.viewer.people import Wishes
from agym_jax.viewer.picture import VIEWS
from agym_jax.viewer.plots import Plots
from agym_jax.viewer.stage import Stage

SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0, "4": 4.0, "max": np.inf}
"""Times real time."""
JOG = 0.02  # of the tool, for a key [m]
JOGS = {
    "W": (0.0, 1.0, 0.0, "away"), "S": (0.0, -1.0, 0.0, "nearer"), "A": (-1.0, 0.0, 0.0, "left"),
    "D": (1.0, 0.0, 0.0, "right"), "E": (0.0, 0.0, 1.0, "up"), "Q": (0.0, 0.0, -1.0, "down"),
}  # fmt: skip
"""Key -> the way that it moves the tool, as the camera "front" sees it."""
NAMES = {"robot": "Robot", "human": "Person"}


class Page(Protocol):
    """What the controls need of the page."""

    server: viser.ViserServer
    stage: Stage

    def ask(self, call: Callable[[], None]) -> None:
        """Have the page's loop do something; from any thread."""
        ...

    def toggle(self) -> None:
        """Play or pause."""
        ...

    def single_step(self) -> None:
        """Pause, and do one control step."""
        ...

    def again(self) -> None:
        """Begin the same episode anew."""
        ...

    def next(self) -> None:
        """Begin the episodes of the next people."""
        ...

    def set_speed(self, speed: float) -> None:
        """Play faster or slower; 1 is real time."""
        ...

    def look(self, client: Any, name: str) -> None:
        """Move the camera of one browser."""
        ...

    def draw_forces(self) -> None:
        """Draw the forces of contacts, or hide them."""
        ...


def from_user(call: Callable[[Any], None]) -> Callable[[Any], None]:
    """A callback that ignores what the program itself has set."""

    def run(event: Any) -> None:
        if event.client_id is not None:
            call(event)

    return run


class Panels:
    """All controls.

    Args:
        page: whose they are.
    """

    def __init__(self, page: Page):
        self.page, gui = page, page.server.gui
        env = page.stage.env
        self.status = gui.add_markdown("")
        self._time(gui)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Drive"):
            self.joints = Drive(page)
        with tabs.add_tab("Person"):
            self.person = Person(page)
        with tabs.add_tab("View"):
            self._view(gui)
        with tabs.add_tab("Plots"):
            self.plots = Plots(gui, env.task.reward_terms, env.episode_length * env.dt)
        self._keys(gui)

    def _time(self, gui: Any) -> None:
        page = self.page
        self.play = gui.add_button("Pause", icon="player-pause", hint="Space")
        self.play.on_click(lambda _: page.ask(page.toggle))
        step = gui.add_button("Step", icon="player-skip-forward", hint="Arrow right")
        step.on_click(lambda _: page.ask(page.single_step))
        moves = gui.add_button_group("Episode", ("Reset", "Next person"))
        moves.on_click(
            lambda event: page.ask(page.again if event.target.value == "Reset" else page.next)
        )
        speed = gui.add_button_group("Speed", tuple(SPEEDS))
        speed.on_click(lambda event: page.ask(lambda: page.set_speed(SPEEDS[event.target.value])))

    def _view(self, gui: Any) -> None:
        page = self.page
        views = (*VIEWS, "all") if page.stage.count > 1 else VIEWS
        camera = gui.add_button_group("Camera", views)
        camera.on_click(lambda event: page.look(event.client, event.target.value))
        self.arrows = gui.add_checkbox(
            "Contact forces", True, visible=page.stage.count == 1,
            hint="Red: robot or tool on the person. Orange: others. 15 cm for 10 N.",
        )  # fmt: skip
        self.arrows.on_update(lambda _: page.ask(page.draw_forces))
        self.onward = gui.add_checkbox("Go on with the next person", True)

    def _keys(self, gui: Any) -> None:
        page = self.page
        for label, key, call in (
            ("Play or pause", "space", page.toggle),
            ("One step", "arrowright", page.single_step),
            ("Reset", "R", page.again),
            ("Next person", "N", page.next),
        ):
            gui.add_command(label, hotkey=key).on_trigger(lambda _, call=call: page.ask(call))
        if page.stage.count > 1:
            return
        for key, (*way, name) in JOGS.items():
            jog = np.array(way) * JOG
            command = gui.add_command(f"Move the tool {name}", hotkey=key)
            command.on_trigger(lambda _, jog=jog: page.ask(lambda: self.joints.jog(jog)))

    def show_playing(self, playing: bool) -> None:
        """What the button does next."""
        self.play.label = "Pause" if playing else "Play"
        self.play.icon = "player-pause" if playing else "player-play"


def short(names: tuple[str, ...]) -> list[str]:
    """Names of joints without what all of them begin with."""
    words = [name.removesuffix("_joint").split("_") for name in names]
    same = next((i for i, w in enumerate(zip(*words, strict=False)) if len(set(w)) > 1), 0)
    plain = [" ".join(word[same:]) for word in words]
    return [f"joint {x}" if x.isdigit() else x for x in plain]


class Drive:
    """Who drives whom, sliders of joints, and the gizmo on the tool.

    Args:
        page: whose it is.
    """

    def __init__(self, page: Page):
        self._page, self._driver = page, page.stage.driver
        gui, self._sliders, self._modes = page.server.gui, {}, {}
        alone = page.stage.count == 1
        for agent in self._driver.joints:
            options = [x for x in self._driver.choices(agent) if alone or x != TOOL]
            mode = gui.add_dropdown(NAMES[agent], options, initial_value=self._driver.modes[agent])
            mode.on_update(
                from_user(lambda e, a=agent: page.ask(lambda: self.set_mode(a, e.target.value)))
            )
            self._modes[agent] = mode
        for agent, joints in self._driver.joints.items():
            with gui.add_folder(f"{NAMES[agent]}'s joints [deg]"):
                self._sliders[agent] = [
                    self._slider(gui, agent, i, name, *np.degrees(joints.limits[i]))
                    for i, name in enumerate(short(joints.names))
                ]
        self._gizmo = page.server.scene.add_transform_controls(
            "/tool_goal", scale=0.18, visible=False, depth_test=False
        )
        self._gizmo.on_update(lambda _: page.ask(self._gizmo_moved))

    def _slider(self, gui: Any, agent: str, i: int, name: str, low: float, high: float) -> Any:
        low, high = max(low, -360.0), min(high, 360.0)
        slider = gui.add_slider(
            name, min=round(low), max=round(high), step=1, initial_value=round((low + high) / 2)
        )
        slider.on_update(
            from_user(lambda e: self._page.ask(lambda: self.set_joint(agent, i, e.target.value)))
        )
        return slider

    def set_mode(self, agent: str, mode: str) -> None:
        """Let somebody else drive; who drives by hand begins where the joints are."""
        self._driver.modes[agent] = self._modes[agent].value = mode
        if mode == JOINTS:
            self._driver.targets[agent] = self._angles(agent)
        if agent == "robot":
            self._gizmo.visible = mode == TOOL
            if mode == TOOL:
                self._set_goal(self._page.stage.arm.pose(self._angles("robot")))

    def set_joint(self, agent: str, i: int, degrees: float) -> None:
        """Ask a joint for an angle [deg]; the user drives from now on."""
        if self._driver.modes[agent] != JOINTS:
            self.set_mode(agent, JOINTS)
        self._driver.targets[agent][i] = np.radians(degrees)

    def jog(self, way: np.ndarray) -> None:
        """Move the tool's goal [m] (3,); the user drives from now on."""
        if self._driver.modes["robot"] != TOOL:
            self.set_mode("robot", TOOL)
        goal = self._driver.goal
        if goal is not None:
            self._set_goal(ToolGoal(goal.pos + way, goal.quat))

    def _set_goal(self, goal: ToolGoal) -> None:
        self._driver.goal = goal
        self._gizmo.position, self._gizmo.wxyz = goal.pos, goal.quat

    def _gizmo_moved(self) -> None:
        if self._driver.modes["robot"] == TOOL:
            pos, quat = np.array(self._gizmo.position), np.array(self._gizmo.wxyz)
            self._driver.goal = ToolGoal(pos, quat)

    def _angles(self, agent: str) -> np.ndarray:
        qpos = np.asarray(self._page.stage.states.data.qpos)[0]
        return np.array(qpos[self._driver.joints[agent].qpos], float)

    def begin(self) -> None:
        """An episode begins: who drives by hand begins where the joints are."""
        for agent, mode in self._driver.modes.items():
            if mode in (JOINTS, TOOL):
                self.set_mode(agent, mode)

    def follow(self) -> None:
        """Show the angles of the joints that the user does not drive."""
        for agent, sliders in self._sliders.items():
            if self._driver.modes[agent] == JOINTS and agent in self._driver.targets:
                continue
            for slider, angle in zip(sliders, np.degrees(self._angles(agent)), strict=True):
                slider.value = int(np.clip(round(angle), slider.min, slider.max))


class Person:
    """Who the person is.

    Args:
        page: whose it is.
    """

    def __init__(self, page: Page):
        self._page, gui = page, page.server.gui
        spec = page.stage.env.task.human
        largest = round(float(np.degrees(2.0 * spec.tremor_amplitude))) or 20
        self._own = gui.add_checkbox(
            "Choose the person", False, hint="Otherwise as drawn for the seed. A change begins the episode again."
        )  # fmt: skip
        self._sex = gui.add_slider("Sex", 0.0, 1.0, 0.05, 0.0, marks=((0.0, "man"), (1.0, "woman")))
        self._stature = gui.add_slider("Height", 0.85, 1.15, 0.01, 1.0)
        self._girth = gui.add_slider("Girth", 0.85, 1.2, 0.01, 1.0)
        self._kind: Any = gui.add_dropdown("Impairment", IMPAIRMENTS)
        self._strength = gui.add_slider("Strength", 0.25, 1.0, 0.05, 1.0)
        self._limits = gui.add_slider("Range of motion", 0.5, 1.0, 0.05, 1.0)
        self._tremor = gui.add_slider("Tremor [deg]", 0, largest, 1, 0)
        self._still = not page.stage.env.scene.moving
        sliders = (
            self._sex,
            self._stature,
            self._girth,
            self._strength,
            self._limits,
            self._tremor,
        )
        self._kind.on_update(from_user(lambda _: page.ask(self._impair)))
        for handle in sliders:
            handle.on_update(from_user(lambda _: page.ask(self._chosen)))
        self._own.on_update(from_user(lambda _: page.ask(self._apply)))

    def _impair(self) -> None:
        """Typical values of an impairment, which the sliders change."""
        kind = self._kind.value
        self._strength.value = 0.5 if kind == "weakness" else 1.0
        self._limits.value = 0.75 if kind == "limits" else 1.0
        self._tremor.value = int(self._tremor.max // 2) if kind == "tremor" else 0
        self._chosen()

    def _chosen(self) -> None:
        self._own.value = True
        self._apply()

    def _apply(self) -> None:
        self._page.stage.wishes = self.wishes()
        self._page.again()

    def wishes(self) -> Wishes:
        """What is asked for."""
        if not self._own.value:
            return Wishes()
        tremor = None if self._still else float(np.radians(self._tremor.value))
        return Wishes(
            self._sex.value, self._stature.value, self._girth.value, self._strength.value, self._limits.value, tremor
        )  # fmt: skip

    def show(self, human: Any) -> None:
        """The person of the episode, where the user has not chosen."""
        if self._own.value:
            return
        tremor = float(np.degrees(np.max(np.abs(np.asarray(human.tremor)), initial=0.0)))
        for handle, value in (
            (self._sex, human.sex), (self._stature, human.stature), (self._girth, human.girth),
            (self._strength, human.strength), (self._limits, human.limit_scale),
        ):  # fmt: skip
            handle.value = float(np.clip(value, handle.min, handle.max))
        self._tremor.value = int(np.clip(round(tremor), 0, self._tremor.max))
        self._kind.value = next((name for name, has in human.impaired.items() if has), "none")
