defmodule Situ.Bridge.GuideTest do
  # The Elixir blocks of the guide and of its pages run, of each page one after the other, in the checkout; a block that
  # ends in `# => value` gives that value.
  use ExUnit.Case

  @checkout Path.expand("../../..", __DIR__)
  # The first block's aliases hold for all of them, as in one file.
  @aliases "alias Situ.{Bridge, Pipeline, Store, Time}\n_ = {Bridge, Pipeline, Store, Time}\n"

  @pages [
    "other-systems.md"
    | Enum.map(
        ~w(mcap ros1 ros2 psi foxglove parquet files protobuf zeromq mqtt sockets),
        &"systems/#{&1}.md"
      )
  ]

  test "there are no other pages" do
    there = Path.wildcard(Path.join(@checkout, "docs/guides/systems/*.md"))
    assert Enum.sort(Enum.map(there, &("systems/" <> Path.basename(&1)))) == Enum.sort(tl(@pages))
  end

  for page <- @pages do
    test "every block of #{page} runs and gives what it says" do
      text = File.read!(Path.join([@checkout, "docs/guides", unquote(page)]))
      blocks = Regex.scan(~r/```elixir\n(.*?)```/s, text, capture: :all_but_first)
      assert blocks != []
      File.cd!(@checkout, fn -> Enum.reduce(blocks, [], &evaluated/2) end)
    end
  end

  defp evaluated([block], binding) do
    {value, binding} = Code.eval_string(@aliases <> block, binding)

    with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, block) do
      {expected, _} = Code.eval_string(String.replace(expected, "\n#", "\n"))
      assert value == expected, "#{block}\ngave #{inspect(value)}"
    end

    binding
  end
end
