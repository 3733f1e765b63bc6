import pytest
import torch

from semloc_core.encoding.encoder import ENCODERS, build_encoder
from semloc_core.errors import ConfigError

AGREED = {
    **{"paper": (True, 4.0), "geodesic_attention": (True, 0.0), "rings": (False, 0.0)},
    **{"bag_of_words": (False, 4.0), "tfidf": (False, 4.0), "histogram": (False, 0.0)},
}
"""Encoder -> whether it is trained, and from how far an object is visible to it, m."""


@pytest.mark.parametrize("name", sorted(ENCODERS))
def test_every_encoder_is_built_from_its_defaults_from_plain_values_and_from_a_struct(name: str) -> None:
    encoder = build_encoder(name, None, 5)
    assert encoder.name == name
    assert build_encoder(name, encoder.config, 5).config == encoder.config
    assert build_encoder(name, {}, 5).config == encoder.config
    assert encoder.trainable == any(weight.requires_grad for weight in encoder.parameters())
    assert encoder.extraction.radius_m > 0
    if name in AGREED:
        assert (encoder.trainable, encoder.extraction.visibility_m) == AGREED[name]


def test_the_agreed_names_are_there() -> None:
    """Model files say them; there may be more."""
    assert AGREED.keys() <= ENCODERS.keys()


def test_an_unknown_name_lists_those_there_are() -> None:
    with pytest.raises(ConfigError, match=r"expected an encoder among paper, .* \(got 'papers'\)"):
        build_encoder("papers", None, 5)


def test_a_labelspace_without_classes_is_refused() -> None:
    with pytest.raises(ConfigError, match="expected at least one class"):
        build_encoder("rings", None, 0)


def test_the_generator_decides_the_initial_weights() -> None:
    def weights(seed: int) -> torch.Tensor:
        encoder = build_encoder("paper", {"layers": 1}, 5, torch.Generator().manual_seed(seed))
        return torch.cat([p.detach().flatten() for p in encoder.parameters()])

    assert torch.equal(weights(1), weights(1))
    assert not torch.equal(weights(1), weights(2))
