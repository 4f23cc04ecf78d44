"""Catalogues of languages that are damaged are left out; English and the others stay."""

import pytest

from tissueid import language

DAMAGED = (b"", b"\xde\x12\x04\x95", b"rubbish" * 9, b"\xde\x12\x04\x95" + b"\xff" * 40)


@pytest.mark.parametrize("content", DAMAGED)
def test_a_damaged_catalogue_is_left_out(tmp_path, monkeypatch, content):
    path = tmp_path / "fr" / "LC_MESSAGES" / "tissueid.mo"
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    monkeypatch.setattr(language, "FOLDER", tmp_path)
    monkeypatch.setattr(language, "languages", language.languages.__wrapped__)
    language.read_catalogue.cache_clear()
    assert language.languages() == {"en": "English"}
    language.set_language("fr")
    assert language.current_language() == "en"
    language.read_catalogue.cache_clear()
