"""What of a training is compiled."""

from types import SimpleNamespace

import pytest

from symo_exp.training.compiling import watches_much
from tests.models.methods import windows


@pytest.mark.parametrize(
    ("watched", "every", "much"), [(16, 1, True), (15, 1, False), (80, 5, True), (79, 5, False)]
)
def test_validation_is_compiled_where_it_sees_as_many_samples_as_training(watched, every, much):
    data = SimpleNamespace(
        batches=lambda epoch: [windows(1, 8), windows(1, 8)],
        val_dataloader=lambda: [windows(1, watched)],
    )
    assert watches_much(SimpleNamespace(datamodule=data, check_val_every_n_epoch=every)) == much


def test_without_data_of_our_own_there_is_nothing_to_compare():
    assert not watches_much(SimpleNamespace(check_val_every_n_epoch=1))
