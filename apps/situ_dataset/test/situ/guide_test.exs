defmodule Situ.Dataset.GuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true

  @guide Path.expand("../../../../docs/guides/a-study.md", __DIR__)

  test "every block of the study runs and gives what it says" do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) > 8

    {aliases, _} =
      blocks |> hd() |> hd() |> String.split("\n") |> Enum.split_with(&(&1 =~ ~r/^alias /))

    aliases = Enum.join(aliases, "\n") <> "\n"

    Enum.reduce(blocks, [], fn [block], binding ->
      {value, binding} = Code.eval_string(aliases <> block, binding)

      with [_, expected] <- Regex.run(~r/^# => (.*)\n/m, block) do
        {expected, _} = Code.eval_string(expected)
        assert value == expected, "#{block}\ngave #{inspect(value)}"
      end

      binding
    end)
  end
end
