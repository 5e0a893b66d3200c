"""Checks the examples of openapi.yaml against their schemas.

    .venv-api/bin/python tools/check_examples.py openapi.yaml
"""

import argparse
import sys
from pathlib import Path

from openapi_schema_validator import OAS31Validator
from openapi_spec_validator.readers import read_from_filename


def faults(document):
    """The faults of each example. An example named like a schema belongs to that schema."""
    parts = document["components"]
    for name, example in parts["examples"].items():
        if name in parts["schemas"]:
            validator = OAS31Validator({"$ref": f"#/components/schemas/{name}", "components": parts})
            for error in validator.iter_errors(example["value"]):
                yield f"{name}: {error.json_path}: {error.message}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("document", type=Path)
    document, _ = read_from_filename(str(parser.parse_args().document))
    sys.exit("\n".join(faults(document)) or None)


if __name__ == "__main__":
    main()
