defmodule Situ.Infer.OnnxModelTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.{OnnxModel, Test.Networks}
  alias Situ.Tensor

  @moduletag :tmp_dir
  @moduletag :capture_log

  setup %{tmp_dir: dir}, do: {:ok, path: Networks.write(Networks.adding(2), dir)}

  defp row(i), do: Tensor.from_list([i * 1.0, i * 2.0], :f32, {1, 2})

  defp rows(p, n),
    do: p |> Situ.from_enumerable(1..n, every: 10) |> Situ.map(&row/1, type: Tensor)

  defp run(build),
    do:
      Situ.to_list(build,
        times: true,
        pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]
      )

  test "accepts streams by input name and emits one output or all of them", %{path: path} do
    out =
      run(fn p -> OnnxModel.run(%{"x" => rows(p, 40), "y" => rows(p, 40)}, path, output: "z") end)

    assert length(out) == 40

    for {{time, tensor}, i} <- Enum.with_index(out, 1),
        do: assert({time, Tensor.to_list(tensor)} == {(i - 1) * 10, [i * 2.0, i * 4.0]})

    [{0, all}] = run(fn p -> OnnxModel.run(%{"x" => rows(p, 1), "y" => rows(p, 1)}, path) end)
    assert Tensor.to_list(all["twice"]) == [4.0, 8.0]
  end

  test "runs queued messages as one batch", %{path: path} do
    {:ok, state} =
      OnnxModel.init(
        path: path,
        output: "z",
        batch: 4,
        device: :cpu,
        shapes: %{},
        model_options: []
      )

    {[], state} = OnnxModel.handle_start(%Situ.Component.Context{}, state)

    messages =
      for i <- 1..8, do: %Situ.Message{data: %{"x" => row(i), "y" => row(i)}, originating_time: i}

    runs = Situ.Infer.Model.run_stats(state.model).runs
    {actions, state} = OnnxModel.handle_messages(:in, messages, %Situ.Component.Context{}, state)

    assert for({:out, t, tensor} <- actions, do: {t, hd(Tensor.to_list(tensor))}) ==
             for(i <- 1..8, do: {i, i * 2.0})

    assert Situ.Infer.Model.run_stats(state.model).runs == runs + 2
  end

  describe "while the pipeline is built, rejects" do
    defp refused(streams, path, opts \\ []) do
      {:error, error} = Situ.Pipeline.run(fn p -> OnnxModel.run(streams.(p), path, opts) end)
      error.meta[:reason] || error
    end

    test "unknown input names and missing streams", %{path: path} do
      assert %{code: :unknown_input, why: why} =
               refused(&%{"x" => rows(&1, 1), "v" => rows(&1, 1)}, path)

      assert why =~ ~s("x", "y")
      assert %{code: :missing_input, what: what} = refused(&%{"x" => rows(&1, 1)}, path)
      assert what =~ ~s("y")
      assert %{code: :missing_input} = refused(&rows(&1, 1), path)
      both = &%{"x" => rows(&1, 1), "y" => rows(&1, 1)}

      assert %{code: :unknown_output, fix: ~s(did you mean "twice"?)} =
               refused(both, path, output: "twize")
    end

    test "other shapes, naming both, and CUDA without support", %{path: path} do
      both = &%{"x" => rows(&1, 1), "y" => rows(&1, 1)}

      assert %{code: :model_shape, what: what} =
               refused(both, path, shapes: %{"x" => {:f32, {nil, 3}}})

      assert what =~ "{-1, 2}" and what =~ "{nil, 3}"
      assert %{code: :no_provider, fix: "" <> _} = refused(both, path, device: :cuda)
      assert %{code: :no_model_file} = refused(both, path <> "x")
    end
  end

  test "tensors of another shape are an error of the component", %{path: path} do
    wrong = fn p ->
      p
      |> Situ.from_enumerable([Tensor.zeros(:f32, {1, 3})], every: 1)
      |> Situ.map(& &1, type: Tensor)
    end

    assert {:error, error} =
             Situ.Pipeline.run(fn p ->
               OnnxModel.run(%{"x" => wrong.(p), "y" => rows(p, 1)}, path)
             end)

    assert Exception.message(error) =~ "{1, 3}"
  end
end
