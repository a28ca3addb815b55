"""The links of a chain together with the draws that they follow from: one kernel, which needs no gradient."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from kvision._ops import FastPath
from kvision.augmentation.columns import DrawPlan
from kvision.augmentation.displacements import NoiseField
from kvision.augmentation.drawn_pass import COMPUTED_IN_FLOAT32, packed
from kvision.augmentation.keys import Keys
from kvision.augmentation.transforms import MatrixPlan

_draw_links = FastPath("draw_links", COMPUTED_IN_FLOAT32)


class DrawnLinks:
    """Draws, and the matrices and fields of displacements of a chain that follow from them."""

    def __init__(self, draws: DrawPlan, links: Sequence[MatrixPlan | NoiseField]) -> None:
        self.draws = draws
        self._matrices = [link for link in links if isinstance(link, MatrixPlan)]
        self._fields = [link for link in links if isinstance(link, NoiseField)]
        results = [*self._matrices, *self._fields]  # after the columns
        self._order = [next(i for i, result in enumerate(results) if result is link) for link in links]
        self.has_kernel = draws.learned is None and all(len(m.launches) == 1 for m in self._matrices)
        self._plan: tuple[Tensor, Tensor] | None = None

    def draw(self, x: Tensor, keys: Keys) -> tuple[Tensor, None, list[Tensor] | None]:
        """The columns, no result, and the links for images `x`; None instead of these where there is no kernel of all."""
        images = x.detach() if x.requires_grad else x
        if not self.has_kernel or not _draw_links.serves(images):
            return self.draws.draw(images, keys), None, None
        if self._plan is None:
            self._plan = self._packed()
        columns, *results = _draw_links.kernel(images, self.draws.keys_of(keys), keys.seeds_on(x.device), *self._plan)
        return columns, None, [results[i] for i in self._order]

    def _packed(self) -> tuple[Tensor, Tensor]:
        """The plan and the numbers of the kernel.

        The plan is the length of the plan of the draws, and that plan; how many of the numbers belong to the draws; the number of
        matrices, and the length and the plan of each; then the plan of each field.
        """
        draws = self.draws
        plan = [len(draws.plan), *draws.plan, len(draws.numbers), len(self._matrices)]
        numbers = list(draws.numbers)
        for matrix in self._matrices:
            ((chain, chain_numbers),) = matrix.launches
            plan += [len(chain), *chain]
            numbers += chain_numbers
        for field in self._fields:
            plan += [*field.size, *field.noise, *field.blur[:2]]
            numbers += [*field.blur[2:], *field.scale]
        return packed(plan, numbers)
