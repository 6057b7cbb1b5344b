defmodule Situ.Infer.Detection.Masks do
  @moduledoc false
  # Computes the masks of detected objects. Each box's coefficients weight the network's
  # prototypes `{1, k, height, width}`, and the mask covers the pixels where the sigmoid of the
  # sum is above one half (Bolya et al., "YOLACT", 2019). ONNX Runtime computes the sums.
  alias Situ.{Error, Image, Tensor}
  alias Situ.Infer.{Model, Onnx}

  @enforce_keys [:model, :count, :size]
  defstruct [:model, :count, :size]

  @type t :: %__MODULE__{
          model: Model.t(),
          count: pos_integer(),
          size: {pos_integer(), pos_integer()}
        }

  @doc "Builds the mask computation for a prototype output of this shape and type."
  @spec new(tuple(), Tensor.element_type()) :: {:ok, t()} | {:error, Error.t()}
  def new(shape, type \\ :f32)

  def new({_, count, h, w}, type)
      when count > 0 and h > 0 and w > 0 and type in [:f32, :f16] do
    bytes =
      Onnx.encode(
        inputs: [{"weights", :f32, {nil, count}}, {"prototypes", type, {1, count, h, w}}],
        outputs: [{"masks", :u8, {nil, h * w}}],
        constants: %{
          "flat" => Tensor.from_list([count, h * w], :s64, {2}),
          "zero" => Tensor.from_list([0.0], :f32, {1}),
          "white" => Tensor.from_list([255.0], :f32, {1})
        },
        nodes: [
          {"Cast", ["prototypes"], ["floats"], [to: 1]},
          {"Reshape", ["floats", "flat"], ["kinds"], []},
          {"MatMul", ["weights", "kinds"], ["sums"], []},
          # The sigmoid is above a half where the sum is above zero.
          {"Greater", ["sums", "zero"], ["inside"], []},
          {"Cast", ["inside"], ["ones"], [to: 1]},
          {"Mul", ["ones", "white"], ["bright"], []},
          {"Cast", ["bright"], ["masks"], [to: 2]}
        ]
      )

    with {:ok, model} <- Model.from_bytes(bytes, "masks", warm_up: 0, sessions: 1),
         do: {:ok, %__MODULE__{model: model, count: count, size: {w, h}}}
  end

  def new(shape, _type) do
    {:error,
     Error.new(
       :model_shape,
       "mask prototypes must have the shape {1, n, height, width}, not #{inspect(shape)}",
       fix: "give the name of the prototype output as masks:"
     )}
  end

  @doc """
  Returns a `:gray8` image for each box, 255 where the object is. It is the part of the prototypes under the box; the
  prototypes cover the whole input image. `side` is the side of the network's input.
  """
  @spec cut_masks(t(), [map()], Tensor.t(), pos_integer()) ::
          {:ok, [Image.t()]} | {:error, Error.t()}
  def cut_masks(_masks, [], _prototypes, _side), do: {:ok, []}

  def cut_masks(%__MODULE__{size: {w, h}} = masks, boxes, prototypes, side) do
    weights =
      Tensor.from_list(Enum.flat_map(boxes, & &1.mask), :f32, {length(boxes), masks.count})

    with {:ok, %{"masks" => all}} <-
           Model.run(masks.model, %{"weights" => weights, "prototypes" => prototypes}) do
      {:ok,
       for {box, i} <- Enum.with_index(boxes) do
         crop_mask(binary_part(all.data, i * w * h, w * h), {w, h}, box, side)
       end}
    end
  end

  defp crop_mask(plane, {w, h}, box, side) do
    {x0, x1} = pixel_range(box.x, box.width, w / side, w)
    {y0, y1} = pixel_range(box.y, box.height, h / side, h)
    rows = for y <- y0..(y1 - 1), into: "", do: binary_part(plane, y * w + x0, x1 - x0)
    Image.new!(width: x1 - x0, height: y1 - y0, format: :gray8, data: rows)
  end

  # The range has at least one pixel, and all of its pixels are within the image.
  defp pixel_range(from, length, scale, most) do
    low = from |> Kernel.*(scale) |> floor() |> max(0) |> min(most - 1)
    high = (from + length) |> Kernel.*(scale) |> ceil() |> max(low + 1) |> min(most)
    {low, high}
  end
end
