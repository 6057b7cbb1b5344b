defmodule Situ.Studio.SpaceGuideTest do
  # The blocks of docs/guides/space.md run and give what they say.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../../../docs/guides/space.md", __DIR__)
  @external_resource @guide

  @tag :tmp_dir
  test "every block of the guide runs", %{tmp_dir: folder} do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) >= 8
    Enum.reduce(blocks, {[folder: folder], __ENV__}, fn [block], state -> run(block, state) end)
  end

  defp run(block, {binding, env}) do
    {value, binding, env} = Code.eval_quoted_with_env(Code.string_to_quoted!(block), binding, env)

    with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, block) do
      {expected, _} = Code.eval_string(expected)
      assert value == expected, "#{block}\ngave #{inspect(value)}"
    end

    {binding, env}
  end
end
