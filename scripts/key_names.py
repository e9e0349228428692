"""Write navsim/scenario/keys.json, the names of all keys, from the models: `make docs`."""

from __future__ import annotations

from navsim.scenario.key_names import FILE, collected, text


def main() -> None:
    FILE.write_text(text(collected()), encoding="utf-8")
    print(f"{FILE} written")


if __name__ == "__main__":
    main()
