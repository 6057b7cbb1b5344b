defmodule Situ.CLI.SettingTest do
  use ExUnit.Case, async: true
  alias Situ.CLI.Setting
  doctest Setting

  test "a setting without a name or a value is wrong usage" do
    for text <- ["count", "=3", ""],
        do: assert({:usage, _} = catch_throw(Setting.parse_settings(["a=1", text])))
  end
end
