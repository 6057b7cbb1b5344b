defmodule Situ.Examples.SpeechGuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../docs/guides/speech.md", __DIR__)
  @moduletag [timeout: 240_000, moonshine: true]

  test "every block of speech.md runs and gives what it says" do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) == 5

    Enum.reduce(blocks, {[], __ENV__}, fn [block], {binding, env} ->
      {value, binding, env} =
        block |> Code.string_to_quoted!() |> Code.eval_quoted_with_env(binding, env)

      [_, expected] = Regex.run(~r/^# => (.*)\z/ms, block)
      {expected, _} = Code.eval_string(expected)
      assert value == expected, "#{block}\ngave #{inspect(value)}"
      {binding, env}
    end)
  end
end
