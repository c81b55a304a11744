"""What a law does where the target of its certificate is: it stays there, as long as it can."""

from __future__ import annotations

import numpy as np

from holdfast.analysis.certificates.cells import Counted, Floats, Halvings, Truths, Wholes
from holdfast.analysis.certificates.certificate import Certificate
from holdfast.analysis.certificates.images import Images, images, sure_of
from holdfast.execution.intervals.held_flow import HeldFlow
from holdfast.maths.definitions.quantity import symbol

NONE = -1


def flow_of(certificate: Certificate) -> HeldFlow:
    """The enclosures that a certificate was found with."""
    ranges = certificate.ranges
    return HeldFlow(
        certificate.rates,
        [e for _, _, e in certificate.constraints],
        [symbol(n) for n, _ in certificate.states],
        [symbol(n) for n, _ in certificate.inputs],
        {symbol(n): ranges[n] for n, _ in certificate.disturbances},
        {symbol(n): ranges[n] for n, _ in certificate.parameters},
        certificate.sampling,
        [e for _, _, e in certificate.target],
    )


def inputs_at_target(certificate: Certificate) -> tuple[Wholes, Wholes]:
    """The cells of the target, and for each the input that was tried and is best there.

    That is one which keeps the target at every sample from now on; where none does, one which leads
    to cells of the target or to certified ones; NONE where none does either. The region is kept on
    the way. Of several it is the one that is nearest to zero, in parts of what was tried.
    """
    cells, tried = certificate.cells, certificate.candidates
    flow = flow_of(certificate)
    target = sure_of(flow.arrived, Halvings(cells, certificate.kept.depth))
    all_images = images(flow, cells, tried, target, lambda what, share: None)
    stays = np.ones(len(target), dtype=bool)
    while True:
        leads = _led(all_images, stays, Counted(cells, _noted(certificate, target[stays])))
        if (stays == (stays & leads.any(axis=1))).all():
            break
        stays &= leads.any(axis=1)
    certified = np.concatenate([target, certificate.kept.members])
    again = _led(all_images, ~stays, Counted(cells, _noted(certificate, certified)))
    leads = np.where(stays[:, None], leads, again)
    order = _from_zero(tried)
    first = order[leads[:, order].argmax(axis=1)]
    return target, np.where(leads.any(axis=1), first, NONE)


def _noted(certificate: Certificate, of: Wholes) -> Truths:
    noted = np.zeros(int(np.prod(certificate.cells.counts)), dtype=bool)
    noted[of] = True
    return noted


def _led(images: Images, rows: Truths, into: Counted) -> Truths:
    """Whether each input leads from each of these cells into a set, shape (cells, inputs)."""
    asked = images.usable & rows[:, None]
    leads = np.zeros(asked.shape, dtype=bool)
    leads[asked] = into.all_of(
        images.first[asked].astype(np.int64), images.last[asked].astype(np.int64)
    )
    return leads


def _from_zero(tried: Floats) -> Wholes:
    """The numbers of inputs, those that are nearest to zero first."""
    most = np.abs(tried).max(axis=0)
    order: Wholes = ((tried / np.where(most > 0, most, 1)) ** 2).sum(axis=1).argsort(kind="stable")
    return order
