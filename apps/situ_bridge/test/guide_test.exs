defmodule Situ.Bridge.GuideTest do
  # The Elixir blocks of the guide and of its pages run, of each page one after the other, in the checkout; a block that
  # ends in `# => value` gives that value.
  use ExUnit.Case

  @checkout Path.expand("../../..", __DIR__)
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
      guide = Path.join([@checkout, "docs/guides", unquote(page)])
      File.cd!(@checkout, fn -> assert Situ.Test.Guide.run(guide) > 0 end)
    end
  end
end
