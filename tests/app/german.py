"""Check that a message has no English part in a German window."""

from tissueid.language import current_language, set_language
from tissueid.messages import Message, translated


def assert_german(text: str) -> None:
    """Fail for a text that is no message, or whose template or message values are not translated to German."""
    assert isinstance(text, Message), text
    before = current_language()
    set_language("de")
    try:
        assert translated(text) != str(text)
        for value in text.values.values():
            if isinstance(value, Message):
                assert_german(value)
    finally:
        set_language(before)
