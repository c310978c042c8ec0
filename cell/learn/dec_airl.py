"""Dec-AIRL, the baseline: TB-DecAIRL with beliefs and type-contingency taken out, all else equal."""

from __future__ import annotations

from cell.learn.belief.bank import BeliefBank
from cell.learn.discriminator import Transitions
from cell.learn.domain.presets import Preset
from cell.learn.settings import Settings
from cell.learn.tb_decairl import TbDecAirl


def dec_airl(preset: Preset, beliefs: BeliefBank, expert: Transitions, settings: Settings) -> TbDecAirl:
    """The run of Algorithm 1 whose actors are pi_i(a_i | s_i), critic V(s), and discriminator D(s, a, s').

    The expert and its demonstrations stay as they are: what the baseline lacks is the belief input, so
    `beliefs` still drives nothing but the (ignored) belief columns of the rollouts.
    """
    return TbDecAirl(preset, beliefs, expert, settings.change(beliefs=False))
