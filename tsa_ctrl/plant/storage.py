"""Parameters kept through a power cycle (CiA 301): 0x1010 "save", 0x1011 "load"."""

from __future__ import annotations

from tsa_ctrl.plant.dictionary import AbortCode, Access, Entry, Key, ObjectDictionary, SdoAbort, Type

SAVE = 0x65766173  # "save", least significant byte first
LOAD = 0x64616F6C  # "load"
_ON_COMMAND = 1  # bit 0 of both objects when read
_PASSING: frozenset[Key] = frozenset({(0x1003, 0), (0x6040, 0), (0x6071, 0)})  # commands are no parameters


def entries() -> list[Entry]:
    """Both objects; one group of parameters, on command."""
    return [
        Entry(0x1010, 0, Type.U8, Access.CONST, 1),
        Entry(0x1010, 1, Type.U32, Access.RW, _ON_COMMAND),
        Entry(0x1011, 0, Type.U8, Access.CONST, 1),
        Entry(0x1011, 1, Type.U32, Access.RW, _ON_COMMAND),
    ]


class Storage:
    """Of one node; `saves` counts, since the plant began: a master that saves wears a memory out."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self.saves = 0
        dictionary.on_write[0x1010, 1] = self._save
        dictionary.on_write[0x1011, 1] = self._load

    def _save(self, value: int) -> None:
        if value != SAVE:
            raise SdoAbort(AbortCode.CANNOT_STORE)
        dictionary = self._dictionary
        self.saves += 1
        for key, entry in dictionary.entries.items():
            if entry.access is Access.RW and isinstance(entry.default, int) and key not in _PASSING:
                dictionary.stored[key] = dictionary.values[key]
        self._forget_command(0x1010)

    def _load(self, value: int) -> None:
        """The defaults come back with the next reset."""
        if value != LOAD:
            raise SdoAbort(AbortCode.CANNOT_STORE)
        self._dictionary.stored.clear()
        self._forget_command(0x1011)

    def _forget_command(self, index: int) -> None:
        for place in (0x1010, 0x1011):
            self._dictionary.stored.pop((place, 1), None)
