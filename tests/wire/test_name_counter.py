"""A sender of ever new names fills no memory and no terminal."""

from semloc_core.wire.name_counter import MAX_LENGTH, MAX_NAMES, OTHERS, NameCounter


def test_names_are_counted_as_they_are():
    names = NameCounter()
    for thing, name in enumerate(("sofa", "sofa", "Sessel groß", "椅子")):
        names.see(name, str(thing))
    assert names == {"sofa": 2, "Sessel groß": 1, "椅子": 1}


def test_any_number_of_names_of_any_length_stays_small():
    names = NameCounter()
    for i in range(3 * MAX_NAMES):
        names.see(f"{i} \x1b[2J\n" + "x" * 10_000, str(i))
    names.see("0 \x1b[2J\n" + "x" * 10_000, "again")
    assert len(names) == MAX_NAMES + 1
    assert names[OTHERS] == 2 * MAX_NAMES
    assert names.total() == 3 * MAX_NAMES + 1
    assert all(len(name) < 2 * MAX_LENGTH and name.isprintable() for name in names)


def test_a_thing_that_is_seen_again_counts_once_until_all_is_forgotten():
    """Publishers repeat their whole graph every few seconds."""
    names = NameCounter()
    for _ in range(6):
        names.see("lamp", "O1")
        names.see("lamp", "O2")
    assert names == {"lamp": 2}
    names.clear()
    names.see("lamp", "O1")
    assert names == {"lamp": 1}


def test_any_number_of_things_fills_no_memory(monkeypatch):
    monkeypatch.setattr("semloc_core.wire.name_counter.MAX_THINGS", 10)
    names = NameCounter()
    for i in range(100):
        names.see("lamp", str(i))
    assert names == {"lamp": 10}
    assert len(names._things) == 10
