defmodule Situ.Store.GuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  # The first block's aliases hold for all of them, as in one file.
  @aliases "alias Situ.{Pipeline, Store, Time}\n_ = {Pipeline, Store, Time}\n"
  @guide Path.expand("../../../docs/guides/recording-and-replaying.md", __DIR__)

  test "every block runs and gives what it says" do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) > 8

    Enum.reduce(blocks, [], fn [block], binding ->
      {value, binding} = Code.eval_string(@aliases <> block, binding)

      with [_, expected] <- Regex.run(~r/^# => (.*)\n/m, block) do
        {expected, _} = Code.eval_string(expected)
        assert value == expected, "#{block}\ngave #{inspect(value)}"
      end

      binding
    end)
  end
end
