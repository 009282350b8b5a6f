"""A Cessna 172 in JSBSim (pip install jsbsim, LGPL-2.1): elevator to pitch, with the dynamic pressure beside it.

Wings are held level, and the throttle holds the speed, by laws that are not retuned.
"""

from typing import Any

import jsbsim

FRAME_S = 1 / 120
HEIGHT_FT, SPEED_KT, THROTTLE, MIXTURE = 4000.0, 95.0, 0.7, 0.87


class Aircraft:
    """Trimmed for level flight. Inputs: elevator in percent, nose up, from trim; faster in knots over `speed_kt`."""

    def __init__(self, speed_kt: float = SPEED_KT) -> None:
        jsbsim.FGJSBBase().debug_lvl = 0
        self.fdm: Any = jsbsim.FGFDMExec(jsbsim.get_default_root_dir())
        self.fdm.set_debug_level(0)
        self.fdm.load_model("c172p")
        for name, value in (("ic/h-sl-ft", HEIGHT_FT), ("ic/vc-kts", speed_kt), ("ic/gamma-deg", 0.0)):
            self.fdm[name] = value
        self.fdm.run_ic()
        self.fdm["propulsion/set-running"] = -1
        self.fdm["fcs/mixture-cmd-norm"] = MIXTURE
        self.fdm["fcs/throttle-cmd-norm"] = THROTTLE
        self.fdm.do_trim(1)
        self.speed_kt, self.throttle = speed_kt, float(self.fdm["fcs/throttle-cmd-norm"])
        self.behind_s = 0.0

    @property
    def pv(self) -> dict[str, float]:
        """Pitch in degrees, dynamic pressure in pounds per square foot."""
        return {"pitch": float(self.fdm["attitude/theta-deg"]), "qbar": float(self.fdm["aero/qbar-psf"])}

    def step(self, co: dict[str, float], dt: float) -> dict[str, float]:
        """Fly whole frames for dt seconds; what is left of a frame is flown in the next step."""
        f = self.fdm
        f["fcs/elevator-cmd-norm"] = min(max(-co["elevator"] / 100.0, -1.0), 1.0)
        self.behind_s += dt
        while self.behind_s > FRAME_S / 2:
            f["fcs/aileron-cmd-norm"] = min(max(-0.03 * f["attitude/phi-deg"] - 0.5 * f["velocities/p-rad_sec"], -1), 1)
            slow_kt = self.speed_kt + co.get("faster", 0.0) - f["velocities/vc-kts"]
            f["fcs/throttle-cmd-norm"] = min(max(self.throttle + 0.05 * slow_kt, 0.0), 1.0)
            f.run()
            self.behind_s -= FRAME_S
        return self.pv
