defmodule Situ.Media.PicturesGuideTest do
  # The blocks of docs/guides/pictures-and-sound.md run, give what they say, and make the pictures the page shows.
  # SITU_PICTURES=write makes the page's pictures anew.
  use ExUnit.Case, async: true
  alias Situ.Imaging

  @guides Path.expand("../../../../docs/guides", __DIR__)
  @pictures Path.join(@guides, "pictures-and-sound")

  @tag :tmp_dir
  test "every block of the guide runs and its pictures are the page's", %{tmp_dir: tmp} do
    text = File.read!(Path.join(@guides, "pictures-and-sound.md"))
    blocks = Regex.scan(~r/```elixir\n(.*?)```/s, text, capture: :all_but_first)
    assert length(blocks) > 10

    write? = System.get_env("SITU_PICTURES") == "write"
    out = if write?, do: @pictures, else: tmp
    state = {[folder: @pictures, out: out], __ENV__}
    Enum.reduce(blocks, state, fn [block], state -> run(block, state) end)

    shown = Regex.scan(~r/\]\(pictures-and-sound\/(.*?)\)/, text, capture: :all_but_first)
    made = Enum.reject(List.flatten(shown), &(&1 == "astronaut.jpg"))
    assert length(made) == 5

    for name <- made do
      page = Imaging.read!(Path.join(@pictures, name))
      fresh = Imaging.read!(Path.join(out, name))

      # Releases of OpenCV and libjpeg-turbo differ in details; a wrong operator differs everywhere.
      {:ok, %{mean: mean}} = Imaging.compare(page, fresh)
      assert mean < 1.0, "#{name} is out of date"
    end
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
