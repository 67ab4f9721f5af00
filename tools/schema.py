"""Write docs/results-schema.json from the types of `crosscheck.document`: python tools/schema.py"""

import json
from pathlib import Path

from crosscheck.report.schema import json_schema

TARGET = Path(__file__).resolve().parents[1] / "docs" / "results-schema.json"

if __name__ == "__main__":
    TARGET.write_text(json.dumps(json_schema(), indent=1) + "\n", encoding="utf-8")
