defmodule Situ.GuidesTest do
  # The Elixir blocks of the guides run, one after the other; a block that ends in `# => value` gives that value. The
  # pictures are what their script draws.
  use ExUnit.Case, async: true

  @guides Path.expand("../../../docs/guides", __DIR__)

  for guide <- ["fusing-streams.md"] do
    @tag :capture_log
    test "every block of #{guide} runs and gives what it says" do
      text = File.read!(Path.join(@guides, unquote(guide)))
      blocks = Regex.scan(~r/```elixir\n(.*?)```/s, text, capture: :all_but_first)
      assert length(blocks) > 5

      Enum.reduce(blocks, [], fn [block], binding ->
        {value, binding} = Code.eval_string(block, binding)

        with [_, expected] <- Regex.run(~r/^# => (.*)\z/ms, block) do
          {expected, _} = Code.eval_string(String.replace(expected, "\n#", "\n"))
          assert value == expected, "#{block}\ngave #{inspect(value)}"
        end

        binding
      end)
    end
  end

  test "the pictures of the guide are drawn from what the operators give" do
    System.put_env("SITU_PICTURES", "test")
    Code.require_file(Path.join(@guides, "fusing-streams/pictures.exs"))
    pictures = apply(Situ.Guide.Pictures, :all, [])
    assert map_size(pictures) == 7

    for {name, svg} <- pictures do
      assert File.read!(Path.join([@guides, "fusing-streams", name])) == svg,
             "#{name} is out of date"
    end
  end
end
