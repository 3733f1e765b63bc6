"""A sender of ever new names fills no memory and no terminal."""

from semloc_core.wire.name_counter import MAX_LENGTH, MAX_NAMES, OTHERS, NameCounter


def test_names_are_counted_as_they_are():
    names = NameCounter()
    for name in ("sofa", "sofa", "Sessel groß", "椅子"):
        names.see(name)
    assert names == {"sofa": 2, "Sessel groß": 1, "椅子": 1}


def test_any_number_of_names_of_any_length_stays_small():
    names = NameCounter()
    for i in range(3 * MAX_NAMES):
        names.see(f"{i} \x1b[2J\n" + "x" * 10_000)
    names.see("0 \x1b[2J\n" + "x" * 10_000)
    assert len(names) == MAX_NAMES + 1
    assert names[OTHERS] == 2 * MAX_NAMES
    assert names.total() == 3 * MAX_NAMES + 1
    assert all(len(name) < 2 * MAX_LENGTH and name.isprintable() for name in names)
