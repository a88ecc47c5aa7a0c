from pathlib import Path
from program_window import SCREEN, read_screen, wait_for, window
SCRIPTS = Path(__file__).parent / "scripts"
def test_picture(program, tmp_path):
    arguments = ["--window-geometry", "0", "0", *map(str, SCREEN)]
    arguments += ["--python", str(SCRIPTS / "tmp_effects.py"), "--", str(tmp_path)]
    with window(program, arguments, tmp_path) as blender:
        try:
            wait_for(tmp_path / "ready", blender, 240)
        finally:
            read_screen(tmp_path).save("/tmp/docs_work/panel.png")
            print(open(tmp_path/"blender.log").read()[-2000:], list(tmp_path.glob("err")) and (tmp_path/"err").read_text())
