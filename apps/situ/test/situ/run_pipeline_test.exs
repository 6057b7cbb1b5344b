defmodule Situ.RunPipelineTest do
  use ExUnit.Case, async: true
  alias Situ.Test

  defmodule Scaled do
    use Situ.Pipeline, options: [factor: [type: :number, default: 2, doc: "The factor."]]

    @impl true
    def build(p, opts) do
      p
      |> Situ.from_enumerable([{0, 1}, {5, 2}])
      |> Situ.map(&(&1 * opts[:factor]), name: "Scaled")
      |> Situ.filter(&(&1 > 100), name: "Large")

      # The result of the function does not matter.
      :built
    end
  end

  test "returns the named streams of a module, with the defaults of its options" do
    assert Test.run_pipeline(Scaled, ["Scaled", "Large"]) ==
             {:ok, %{"Scaled" => [{0, 2}, {5, 4}], "Large" => []}}

    assert Test.run_pipeline(Scaled, ["Scaled"], factor: 0.5) ==
             {:ok, %{"Scaled" => [{0, 0.5}, {5, 1.0}]}}
  end

  test "reports a wrong option, an unknown stream and a failing pipeline" do
    assert {:error, %{code: :unknown_option}} = Test.run_pipeline(Scaled, ["Scaled"], faktor: 2)
    assert {:error, %{code: code}} = Test.run_pipeline(Scaled, ["Scalled"])
    assert code in [:unknown_stream, :build_failed]

    failing = fn p ->
      p |> Situ.from_enumerable([1], every: 1) |> Situ.map(&div(&1, 0), name: "A")
    end

    assert {:error, %{what: what}} = Test.run_pipeline(failing, ["A"])
    assert what =~ "bad argument in arithmetic"
  end
end
