"""docs/surveys.md, typed as it stands, on a real server."""

import json

import pytest
from server_process import ServerProcess
from typed_blocks import ROOT, shell_blocks, typed


@pytest.mark.timeout(240)
def test_the_survey_of_the_page_is_stored_as_it_says(live_server: ServerProcess) -> None:
    make_site, upload = shell_blocks("docs/surveys.md", "curl")
    typed(live_server, make_site)
    survey_id, listed = typed(live_server, upload).split("\n", 1)
    (survey,) = json.loads(listed)["items"]
    assert survey["survey_id"] == survey_id
    assert survey["floors"][0]["fingerprints"] == 2
    assert survey["unusable"]["counts"] == {"unknown floor": 1}
    page = (ROOT / "docs" / "surveys.md").read_text(encoding="utf-8")
    assert page.split("```csv\n")[1].split("```")[0] in upload
