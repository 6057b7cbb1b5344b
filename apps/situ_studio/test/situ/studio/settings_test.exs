defmodule Situ.Studio.SettingsTest do
  use ExUnit.Case, async: true
  alias Situ.Studio.Settings

  doctest Settings

  @moduletag :tmp_dir

  test "loads the defaults from an invalid file", %{tmp_dir: root} do
    layouts = Path.join(root, "layouts")
    assert Settings.load(layouts) == %Settings{}
    file = Path.join(root, "settings.json")

    for text <- ["", "[1]", "{", ~s({"info": 7, "keep": {"a": 1}, "layout": ["x"]})] do
      File.write!(file, text)
      assert Settings.load(layouts) == %Settings{}
    end

    File.write!(file, ~s({"info": "latency", "layout": "Tuned", "of another version": 1}))
    assert Settings.load(layouts) == %Settings{info: :latency, layout: "Tuned"}
  end

  test "reports a folder that cannot be written", %{tmp_dir: root} do
    File.write!(Path.join(root, "file"), "")

    assert {:error, %{code: :not_saved, what: what}} =
             Settings.save(Path.join(root, "file/below/layouts"), %Settings{})

    assert what =~ "settings.json"
  end
end
