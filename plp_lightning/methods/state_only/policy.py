"""The portable latent policy of PLP-T without source actions."""

from __future__ import annotations

from plp_lightning.methods.plp.policy import PortablePolicy


class StateOnlyPolicy(PortablePolicy):
    """A portable latent policy whose latent action is the next latent state (paper, appendix, state-only source).

    π_z(s_z, k) says where to be one step later, ψ(s'_z, s) which action of the target domain leads there. ψ has
    to see where it is now, so ``decoder_state`` can't be ``none``. Arguments are those of :class:`PortablePolicy`.
    """

    @property
    def acts_in(self) -> tuple[str, ...]:
        return (self.problem.target_domain,)  # no action of another domain was ever read
