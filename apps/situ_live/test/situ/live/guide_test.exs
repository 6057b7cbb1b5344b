defmodule Situ.Live.GuideTest do
  # Defines the guide's modules and starts its server.
  use ExUnit.Case, async: false

  @guide Path.expand("../../../../../docs/guides/live-views.md", __DIR__)
  @external_resource @guide

  test "the snippets of the guide run, one after the other" do
    Process.flag(:trap_exit, true)
    snippets = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(snippets) == 3

    Enum.reduce(Enum.concat(snippets), [], fn code, bindings ->
      {_, bindings} = Code.eval_string(code, bindings, file: @guide)
      bindings
    end)
  end
end
