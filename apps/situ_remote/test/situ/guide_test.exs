defmodule Situ.Remote.GuideTest do
  # The Elixir blocks of the guide run, one after the other; a block that ends in `# => value` gives that value.
  use ExUnit.Case, async: true
  import ExUnit.CaptureLog

  @guide Path.expand("../../../../docs/guides/links.md", __DIR__)

  test "every block of the guide runs and gives what it says" do
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, File.read!(@guide), capture: :all_but_first)
    assert length(blocks) > 5
    aliases = blocks |> hd() |> hd() |> String.split("\n") |> Enum.filter(&(&1 =~ ~r/^alias /))
    capture_log(fn -> run(blocks, Enum.join(aliases, "\n") <> "\n") end)
  end

  defp run(blocks, aliases) do
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
