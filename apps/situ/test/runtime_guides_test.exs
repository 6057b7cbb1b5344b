defmodule Situ.RuntimeGuidesTest do
  use ExUnit.Case, async: true
  import ExUnit.CaptureIO

  @moduletag :capture_log
  @folder Path.expand("../../../docs/guides", __DIR__)

  for guide <-
        ~w(your-first-pipeline writing-a-component choosing-a-delivery-policy when-things-fail
            genstage) do
    test "every snippet of #{guide} runs, in its order" do
      path = Path.join(@folder, unquote(guide) <> ".md")

      snippets =
        Regex.scan(~r/^```elixir\n(.*?)^```/ms, File.read!(path), capture: :all_but_first)

      assert snippets != []

      capture_io(fn ->
        Enum.reduce(snippets, [], fn [code], bindings ->
          {_, bindings} =
            Code.eval_string(
              "alias Situ.{Delivery, Pipeline, Time}\n_ = {Delivery, Pipeline, Time}\n" <>
                code,
              bindings,
              file: path
            )

          bindings
        end)
      end)
    end
  end
end
