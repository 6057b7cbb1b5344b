defmodule Situ.Infer.ModelTest do
  use ExUnit.Case, async: true

  alias Situ.Infer.Model
  alias Situ.Infer.Onnx
  alias Situ.Tensor

  doctest Situ.Infer.Model

  @golden Path.expand("../../fixtures/golden", __DIR__)

  defp golden(name), do: File.read!(Path.join(@golden, name))
  defp floats(name), do: for(<<x::float-little-32 <- golden(name)>>, do: x)

  defp pixels(name, scale, offset, shape),
    do: Tensor.from_list(for(<<v <- golden(name)>>, do: v * scale + offset), :f32, shape)

  defp doubling(width) do
    port = fn name -> {name, :f32, {nil, width}} end

    Onnx.encode(
      inputs: [port.("x")],
      outputs: [port.("y")],
      nodes: [{"Add", ["x", "x"], ["y"], []}]
    )
  end

  defp furthest(a, b), do: Enum.zip_with(a, b, &abs(&1 - &2)) |> Enum.max()

  @tag :tmp_dir
  test "runs batches in one call if the first dimension of the file is free", %{tmp_dir: dir} do
    path = Path.join(dir, "double.onnx")
    File.write!(path, doubling(3))
    assert {:ok, model} = Model.load(path, inputs: %{"x" => {:f32, {nil, 3}}})
    assert model.inputs == %{"x" => {:f32, {-1, 3}}}
    assert model.where == :inline

    batch =
      for i <- 1..2, do: %{"x" => Tensor.from_list(List.duplicate(i * 1.0, 3 * i), :f32, {i, 3})}

    runs = Model.run_stats(model).runs
    assert {:ok, [%{"y" => one}, %{"y" => two}]} = Model.run_batch(model, batch)
    assert Tensor.to_list(one) == [2.0, 2.0, 2.0]
    assert two.shape == {2, 3} and Tensor.to_list(two) == List.duplicate(4.0, 6)
    assert Model.run_stats(model).runs == runs + 1
  end

  test "accepts and returns numbers of every type, including half floats" do
    types = [:f16, :bf16, :f32, :f64, :s8, :u8, :s16, :u16, :s32, :u32, :s64, :u64]

    for type <- types do
      port = &{&1, type, {nil, 2}}

      bytes =
        Onnx.encode(
          inputs: [port.("x")],
          outputs: [port.("y")],
          nodes: [{"Identity", ["x"], ["y"], []}]
        )

      assert {:ok, model} = Model.from_bytes(bytes, "same")
      x = Tensor.from_list([1, 2, 3, 4], type, {2, 2})
      assert {:ok, %{"y" => ^x}} = Model.run(model, %{"x" => x})
    end

    half = &{&1, :f16, {2}}

    sum =
      Onnx.encode(
        inputs: [half.("x")],
        outputs: [half.("y")],
        nodes: [{"Add", ["x", "x"], ["y"], []}]
      )

    assert {:ok, model} = Model.from_bytes(sum, "sum")
    # Half floats that are not aligned in memory.
    <<_, data::binary>> = <<0, Tensor.from_list([0.5, -1.5], :f16, {2}).data::binary>>
    assert {:ok, %{"y" => y}} = Model.run(model, %{"x" => Tensor.new(data, :f16, {2})})
    assert Tensor.to_list(y) == [1.0, -3.0]
  end

  test "reports unknown input names and rejects models without tensors" do
    {:ok, model} = Model.from_bytes(doubling(1), "double")
    x = Tensor.from_list([1.0], :f32, {1, 1})
    assert {:error, %{code: :bad_tensor, what: what}} = Model.run(model, %{"x" => x, "z" => x})
    assert what =~ ~s("z")

    # 8 is ONNX's type number for strings.
    port = &{&1, :text, {nil}}

    text =
      Onnx.encode(
        inputs: [port.("x")],
        outputs: [port.("y")],
        nodes: [{"Identity", ["x"], ["y"], []}]
      )

    assert {:error, %{code: :bad_model, what: what}} = Model.from_bytes(text, "words")
    assert what =~ ~s(input "x")
  end

  test "gives the face detector's reference results" do
    {:ok, model} = Model.load(Model.bundled_path("face_detection_short_range.onnx"))
    input = pixels("face_input.u8", 1 / 127.5, -1.0, {1, 128, 128, 3})
    assert {:ok, out} = Model.run(model, %{"input" => input})
    assert furthest(Tensor.to_list(out["classificators"]), floats("face_scores.f32")) < 1.0e-3

    boxes = for <<row::binary-64 <- out["regressors"].data>>, do: row
    best = for <<i::little-64 <- golden("face_best.i64")>>, do: Enum.at(boxes, i)
    found = for row <- best, <<x::float-native-32 <- row>>, do: x
    assert furthest(found, floats("face_boxes.f32")) < 1.0e-2
  end

  test "gives the face mesh's reference results from several processes in parallel" do
    {:ok, model} = Model.load_shared(Model.bundled_path("face_landmark.onnx"))
    input = %{"input_1" => pixels("mesh_input.u8", 1 / 255, 0.0, {1, 192, 192, 3})}

    results =
      1..4
      |> Enum.map(fn _ -> Task.async(fn -> Model.run(model, input) end) end)
      |> Task.await_many(30_000)

    assert [{:ok, out}] = Enum.uniq(results)
    assert furthest(Tensor.to_list(out["conv2d_20"]), floats("mesh_points.f32")) < 1.0e-2
    assert furthest(Tensor.to_list(out["conv2d_30"]), floats("mesh_score.f32")) < 1.0e-3
    assert {:ok, ^model} = Model.load_shared(Model.bundled_path("face_landmark.onnx"))
  end

  test "runs as many calls in parallel as there are sessions" do
    path = Model.bundled_path("face_landmark.onnx")
    input = %{"input_1" => Tensor.zeros(:f32, {1, 192, 192, 3})}

    for sessions <- [1, 3] do
      {:ok, model} = Model.load(path, sessions: sessions)
      one = fn -> for _ <- 1..5, do: {:ok, _} = Model.run(model, input) end
      outputs = 1..6 |> Enum.map(fn _ -> Task.async(one) end) |> Task.await_many(60_000)
      assert [_] = outputs |> Enum.concat() |> Enum.uniq()
      assert Model.run_stats(model).runs == 30
    end
  end

  describe "rejects" do
    test "a missing file" do
      assert {:error, %{code: :no_model_file}} = Model.load("/nowhere/x.onnx")
    end

    @tag :tmp_dir
    test "a truncated file", %{tmp_dir: dir} do
      path = Path.join(dir, "cut.onnx")
      whole = File.read!(Model.bundled_path("face_detection_short_range.onnx"))
      File.write!(path, binary_part(whole, 0, div(byte_size(whole), 2)))
      assert {:error, %{code: :bad_model, fix: "" <> _}} = Model.load(path)
      File.write!(path, "")
      assert {:error, %{code: :bad_model}} = Model.load(path)
    end

    test "a model of another shape, naming both shapes" do
      path = Model.bundled_path("face_landmark.onnx")
      wanted = %{"input_1" => {:f32, {1, 256, 256, 3}}}
      assert {:error, %{code: :model_shape} = error} = Model.load(path, inputs: wanted)
      assert error.what =~ "{1, 192, 192, 3}" and error.what =~ "{1, 256, 256, 3}"
      assert {:error, %{code: :model_shape}} = Model.load(path, outputs: %{"nose" => {:f32, {1}}})
    end

    @tag :tmp_dir
    test "tensors that do not fit", %{tmp_dir: dir} do
      path = Path.join(dir, "double.onnx")
      File.write!(path, doubling(3))
      {:ok, model} = Model.load(path)
      assert {:error, %{code: :bad_tensor}} = Model.run(model, %{})

      assert {:error, %{code: :bad_tensor}} =
               Model.run(model, %{"x" => Tensor.zeros(:f32, {1, 4})})

      assert {:error, %{code: :bad_tensor}} =
               Model.run(model, %{"x" => Tensor.zeros(:f64, {1, 3})})
    end

    test "CUDA if the library does not support it" do
      path = Model.bundled_path("face_landmark.onnx")
      assert {:error, %{code: :no_provider}} = Model.load(path, provider: {:cuda, 0})
    end
  end

  @tag :tmp_dir
  test "names the input of tensors that are broken, missing or of another type", %{
    tmp_dir: dir
  } do
    path = Path.join(dir, "double.onnx")
    File.write!(path, doubling(2))
    {:ok, model} = Model.load(path)

    for {tensor, told} <- [
          {%Tensor{type: :f32, shape: {1, 2}, data: <<1>>}, "1 bytes do not match"},
          {%Tensor{type: :f32, shape: {-1, 2}, data: ""}, "{-1, 2}"},
          {%Tensor{type: :f32, shape: {4_611_686_018_427_387_904, 2}, data: ""}, "0 bytes"},
          {%Tensor{type: :f32, shape: {2}, data: <<0::64>>}, "got f32 {2}"},
          {%Tensor{type: :f64, shape: {1, 2}, data: <<0::128>>}, "got f64 {1, 2}"}
        ] do
      assert {:error, %{code: :bad_tensor, fix: fix} = error} = Model.run(model, %{"x" => tensor})

      assert Exception.message(error) =~ told and Exception.message(error) =~ ~s("x") and
               fix != nil
    end

    assert {:error, %{code: :bad_tensor, fix: fix}} = Model.run(model, %{})
    assert fix =~ ~s("x")
  end

  @tag :tmp_dir
  test "distinguishes a truncated, empty or missing file, a folder and an unsuitable model",
       %{tmp_dir: dir} do
    whole = File.read!(Model.bundled_path("silero_vad.onnx"))
    file = fn name, bytes -> tap(Path.join(dir, name), &File.write!(&1, bytes)) end

    for path <- [file.("cut.onnx", binary_part(whole, 0, 1_000_000)), file.("empty.onnx", "")] do
      assert {:error, %{code: :bad_model, what: what, why: why}} = Model.load(path)
      assert what =~ path and why =~ "truncated"
    end

    for path <- [Path.join(dir, "none.onnx"), dir] do
      assert {:error, %{code: :no_model_file, what: what, why: why}} = Model.load(path)
      assert what =~ path and is_binary(why)
    end

    # The voice activity model needs chunks of 576 samples, and here all sizes are given.
    inputs = %{"input" => {:f32, {1, 1}}, "state" => {:f32, {2, 1, 128}}}

    assert {:error, %{code: :model_failed, what: what, fix: fix}} =
             Model.load(Model.bundled_path("silero_vad.onnx"), inputs: inputs)

    assert what =~ "silero_vad" and what =~ "zeros" and fix =~ "made for"
  end

  @tag :tmp_dir
  test "a model that rejects size 1 loads without a warm-up and runs", %{tmp_dir: dir} do
    # Rows of a free width are placed below two rows of three.
    bytes =
      Onnx.encode(
        inputs: [{"x", :f32, {nil, nil}}],
        outputs: [{"y", :f32, {nil, 3}}],
        constants: %{"top" => Tensor.from_list([1.0, 2.0, 3.0], :f32, {1, 3})},
        nodes: [{"Concat", ["top", "x"], ["y"], [axis: 0]}]
      )

    path = Path.join(dir, "below.onnx")
    File.write!(path, bytes)
    assert {:ok, model} = Model.load(path)
    assert model.where == :dirty
    x = Tensor.from_list([4.0, 5.0, 6.0], :f32, {1, 3})
    assert {:ok, %{"y" => y}} = Model.run(model, %{"x" => x})
    assert Tensor.to_list(y) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    # With an example, the model is warmed up and the measured time decides where it runs.
    assert {:ok, %{where: :inline}} = Model.load(path, example: %{"x" => x})
    # An example that fails to run is an error, because it is not a guess.
    bad = Tensor.zeros(:f32, {1, 2})
    assert {:error, %{code: :model_failed}} = Model.load(path, example: %{"x" => bad})
  end

  @tag :tmp_dir
  test "finds weights in a separate file next to the model file", %{tmp_dir: dir} do
    weights = Tensor.from_list([10.0, 20.0, 30.0], :f32, {3})

    bytes =
      Onnx.encode(
        inputs: [{"x", :f32, {nil, 3}}],
        outputs: [{"y", :f32, {nil, 3}}],
        constants: %{"w" => {:external, "weights.bin", 4, weights}},
        nodes: [{"Add", ["x", "w"], ["y"], []}]
      )

    path = Path.join(dir, "large.onnx")
    File.write!(path, bytes)
    # Without its data file, the error names the missing file.
    assert {:error, %{code: :bad_model, what: what, fix: fix}} = Model.load(path)
    assert what =~ Path.join(dir, "weights.bin") and fix =~ "next to the model file"
    File.write!(Path.join(dir, "weights.bin"), <<0::32, weights.data::binary>>)
    assert {:ok, model} = Model.load(path)
    one = %{"x" => Tensor.from_list([1.0, 2.0, 3.0], :f32, {1, 3})}
    assert {:ok, %{"y" => y}} = Model.run(model, one)
    assert Tensor.to_list(y) == [11.0, 22.0, 33.0]
    # All sessions of the model have the same weights.
    tasks = for _ <- 1..8, do: Task.async(fn -> Model.run(model, one) end)
    assert Enum.all?(Task.await_many(tasks, 30_000), &match?({:ok, %{"y" => ^y}}, &1))
  end
end
