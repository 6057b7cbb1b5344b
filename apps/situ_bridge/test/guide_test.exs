defmodule Situ.Bridge.GuideTest do
  # Runs the Elixir blocks of the guide and its pages in the checkout, one page after the other. A
  # block that ends in `# => value` must return that value.
  use ExUnit.Case

  @checkout Path.expand("../../..", __DIR__)
  @pages [
    "other-systems.md"
    | Enum.map(
        ~w(mcap ros1 ros2 psi foxglove parquet files protobuf zeromq mqtt sockets),
        &"systems/#{&1}.md"
      )
  ]

  test "lists every page of the guide" do
    there = Path.wildcard(Path.join(@checkout, "docs/guides/systems/*.md"))
    assert Enum.sort(Enum.map(there, &("systems/" <> Path.basename(&1)))) == Enum.sort(tl(@pages))
  end

  for page <- @pages do
    test "runs every block of #{page} with the results it shows" do
      guide = Path.join([@checkout, "docs/guides", unquote(page)])
      File.cd!(@checkout, fn -> assert Situ.Test.GuideRunner.run_blocks(guide) > 0 end)
    end
  end
end
