defmodule Situ.Assistant.LanguageModelsGuideTest do
  # Runs the guide's Elixir blocks in order; a block that ends in `# => value` must return that value.
  use ExUnit.Case, async: true
  alias Situ.Infer.Test.ChatServer, as: Server

  @guide Path.expand("../../../docs/guides/language-models.md", __DIR__)

  test "every block of language-models.md runs and returns the value it shows" do
    url = Server.start(&answer/2).url
    assert Situ.Test.GuideRunner.run_blocks(@guide, bindings: [url: url]) == 4
  end

  # A very small language model.
  defp answer(%{body: %{"messages" => turns} = body}, _n) do
    case List.last(turns) do
      %{"role" => "tool", "content" => text} ->
        Server.stream(["The tool said: ", text])

      %{"content" => _} when is_map_key(body, "tools") ->
        function = %{name: "set_timer", arguments: ~s({"minutes": 5})}
        delta = %{tool_calls: [%{index: 0, id: "1", function: function}]}
        call = Server.event(%{choices: [%{delta: delta, finish_reason: "tool_calls"}]})
        [Server.head(), Server.chunk(call), Server.chunk("data: [DONE]\n\n"), Server.chunk("")]

      %{"content" => text} ->
        Server.stream(["You ", "said: ", text])
    end
  end
end
