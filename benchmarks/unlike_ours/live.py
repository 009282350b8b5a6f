"""A story's plant in motion, in absolute units, and what is true of it at any time and place."""

import numpy as np

from unlike_ours.process import Linear, LinearLive
from unlike_ours.story import Partner, Story
from unlike_ours.truth import Truth

PLACES = 25  # Places of a nonlinear plant's range at which truth is asked
FACTORS = 10  # Truth under a drifting gain is asked at every tenth of its factor


class Coupled(Truth):
    """With the partner loop closed: Ms and stability of g11 - g12 C2 g21 / (1 + g22 C2); J as of g11 alone."""

    def __init__(self, process: Linear, partner: Partner, dt: float) -> None:
        super().__init__(process, dt)
        s = 1j * self.w
        c = partner.tuned.kp + partner.tuned.ki / s
        there = partner.here.at(self.w) * c * partner.there.at(self.w) / (1 + partner.own.at(self.w) * c)
        self.g = self.g - there * np.exp(-s * dt / 2)
        self.known = {}


class PlantLive:
    """One sample at a time."""

    def __init__(self, story: Story) -> None:
        self.story, self.h, self.t = story, story.dt / story.sub, 0.0
        plant = story.process
        self.linear = isinstance(plant, Linear)
        self.live = LinearLive(plant, self.h) if isinstance(plant, Linear) else plant.live(story.start_pv, self.h)
        self.truths: dict[float, Truth] = {}
        partner = story.partner
        self.others = [LinearLive(g, self.h) for g in (partner.here, partner.there, partner.own)] if partner else []
        self.other_co = self.other_integral = 0.0

    def move(self, co: float, d: float, dt: float) -> float:
        """Hold co, under a load d, for dt; pv after it."""
        for _ in range(max(1, round(dt / self.h))):
            self.t += self.h
            if not self.linear:
                pv = self.live.move(co, d)
            else:
                u, factor = co - self.story.co_start, self.story.factor(self.t)
                found = self.live.move(u * factor, d * factor)
                pv = self.story.start_pv + found + (self._coupled(u) if self.others else 0.0)
        return pv

    def _coupled(self, u: float) -> float:
        assert self.story.partner is not None
        here, there, own = self.others
        tuned, found = self.story.partner.tuned, here.move(self.other_co)
        y = there.move(u) + own.move(self.other_co)
        self.other_integral -= tuned.ki * y * self.h
        self.other_co = self.other_integral - tuned.kp * y
        return found

    def truth(self, t: float, pv: float) -> Truth:
        """The truth about the process as it is at a time and place."""
        s = self.story
        if isinstance(s.process, Linear):
            factor = s.factor(t)
            key = factor if factor == 1.0 else round(factor * FACTORS) / FACTORS
        else:
            key = s.start_pv + round((pv - s.start_pv) * PLACES / s.span) * s.span / PLACES
        if key not in self.truths:
            self.truths[key] = self._truth(key)
        return self.truths[key]

    def _truth(self, key: float) -> Truth:
        s = self.story
        if not isinstance(s.process, Linear):
            return Truth(s.process.local(key), s.dt)
        if s.partner:
            return Coupled(s.process, s.partner, s.dt)
        return s.truth if key == 1.0 else Truth(s.process.times(key), s.dt)
