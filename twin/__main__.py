"""`python -m twin`: the same as the command `twin`, where scripts are not on the path."""

from twin.cli import app

if __name__ == "__main__":
    app(prog_name="twin")
