"""Nothing that a name holds becomes markup."""

import xml.etree.ElementTree as ET

from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.view.svg import document, element, xml_text


@given(st.text(), st.text())
def test_any_text_survives_as_text(content, attribute):
    text = document(10.0, 20.0, content, attribute, [element("text", xml_text(content), class_=attribute)])
    root = ET.fromstring(text.encode("utf-8"))
    assert len(root) == 4
    allowed = "".join(c for c in content if c.isprintable())
    shown = root[3].text or ""
    assert "".join(c for c in shown if c.isprintable() and c != "\ufffd") == allowed.replace("\ufffd", "")
    assert root.attrib["viewBox"] == "0 0 10 20"


def test_markup_is_escaped():
    assert xml_text("<script>alert('&')</script>") == (
        "&lt;script&gt;alert(&#x27;&amp;&#x27;)&lt;/script&gt;"
    )
    assert (
        element("a", href='"><b>', stroke_width=1.50) == '<a href="&quot;&gt;&lt;b&gt;" stroke-width="1.5"/>'
    )
    assert element("a", x=None) == "<a/>"
