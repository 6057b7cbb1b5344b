defmodule Situ.Infer.ClassifierTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Classifier

  alias Situ.Image
  alias Situ.Infer.{Classifier, Test.Networks}

  @moduletag :tmp_dir

  setup context do
    # Doctests have no temporary folder.
    if dir = context[:tmp_dir], do: [path: Networks.write(Networks.colours(8), dir)], else: []
  end

  defp picture(format, pixel, w \\ 20, h \\ 20),
    do: Image.new!(width: w, height: h, format: format, data: :binary.copy(pixel, w * h))

  test "uses ImageNet's preprocessing and returns the best class first", %{path: path} do
    {:ok, classify} = Classifier.load(path: path, labels: ["red", "green"], top: 3)
    assert {:ok, found} = classify.(picture(:rgb24, <<255, 128, 0>>))

    expected = [
      {"red", (1 - 0.485) / 0.229},
      {"green", (128 / 255 - 0.456) / 0.224},
      {"2", -0.406 / 0.225}
    ]

    for {{label, score}, {name, value}} <- Enum.zip(found, expected),
        do: assert({label, Float.round(score, 4)} == {name, Float.round(value, 4)})

    # The same image in another byte order.
    assert {:ok, ^found} = classify.(picture(:bgr24, <<0, 128, 255>>))
  end

  test "supports softmax, raw values, BGR order and a center crop", %{path: path} do
    raw = [path: path, mean: [0, 0, 0], std: [1, 1, 1], scale: 1]
    {:ok, classify} = Classifier.load(raw ++ [order: :bgr, top: 1])
    assert {:ok, [{"0", 30.0}]} = classify.(picture(:rgb24, <<10, 20, 30>>))

    {:ok, classify} =
      Classifier.load((raw ++ [scale: 0.0, softmax: true]) |> Keyword.delete_first(:scale))

    assert {:ok, [{_, p}, _, _]} = classify.(picture(:rgb24, <<1, 2, 3>>))
    assert_in_delta p, 1 / 3, 1.0e-6

    sides =
      for _ <- 1..10,
          into: "",
          do:
            :binary.copy(<<9, 9, 9>>, 5) <>
              :binary.copy(<<50, 0, 0>>, 10) <> :binary.copy(<<9, 9, 9>>, 5)

    {:ok, classify} = Classifier.load(raw ++ [top: 1])

    assert {:ok, [{"0", 50.0}]} =
             classify.(Image.new!(width: 20, height: 10, format: :rgb24, data: sides))
  end

  test "in a pipeline, takes names from a file and returns nil without an image", %{
    path: path,
    tmp_dir: dir
  } do
    names = Path.join(dir, "names.txt")
    File.write!(names, "red\r\ngreen\nblue\n")
    pictures = [picture(:rgb24, <<0, 0, 200>>), nil, picture(:rgb24, <<0, 200, 0>>)]

    out =
      Situ.to_list(fn p ->
        p
        |> Situ.from_enumerable(pictures, every: 10)
        |> Situ.map(& &1, type: {:optional, Image})
        |> Situ.via(Classifier, path: path, labels: names, top: 1)
      end)

    assert [[{"blue", _}], nil, [{"green", _}]] = out
  end

  test "rejects invalid models and options", %{path: path, tmp_dir: dir} do
    adding = Networks.write(Networks.adding(2), dir, "adding.onnx")
    assert {:error, %{code: :unknown_output}} = Classifier.load(path: adding)
    assert {:error, %{code: :model_shape}} = Classifier.load(path: adding, output: "z")
    assert {:error, %{code: :no_labels}} = Classifier.load(path: path, labels: "/nowhere")
    assert {:error, %{code: :bad_option}} = Classifier.load(path: path, std: [1, 0, 1])
    assert {:error, %{code: :model_shape}} = Classifier.load(path: path, side: 9)
  end

  test "scores that are not numbers are an error that gives the reason", %{tmp_dir: dir} do
    path = Networks.write(Networks.undefined(8), dir)
    {:ok, classify} = Classifier.load(path: path)

    assert {:error, %{code: :bad_scores, what: what, why: why, fix: fix}} =
             classify.(picture(:rgb24, <<1, 2, 3>>))

    assert what =~ "not numbers" and why =~ "NaN" and fix =~ "scale:"
  end
end
