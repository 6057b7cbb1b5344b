defmodule Situ.Bridge.GuideTest do
  # The Elixir blocks of the guide run, one after the other, in the checkout; a block that ends in `# => value` gives
  # that value.
  use ExUnit.Case

  @checkout Path.expand("../../..", __DIR__)
  # The first block's aliases hold for all of them, as in one file.
  @aliases "alias Situ.{Bridge, Pipeline, Store, Time}\n_ = {Bridge, Pipeline, Store, Time}\n"

  test "every block runs and gives what it says" do
    text = File.read!(Path.join(@checkout, "docs/guides/other-systems.md"))
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, text, capture: :all_but_first)
    assert length(blocks) > 8

    File.cd!(@checkout, fn ->
      Enum.reduce(blocks, [], fn [block], binding ->
        {value, binding} = Code.eval_string(@aliases <> block, binding)

        with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, block) do
          {expected, _} = Code.eval_string(String.replace(expected, "\n#", "\n"))
          assert value == expected, "#{block}\ngave #{inspect(value)}"
        end

        binding
      end)
    end)
  end
end
