defmodule Situ.Infer.Vision.ImageInput do
  @moduledoc """
  Prepares the image input of a network: cuts a square out of an image, and scales, normalises and arranges its
  pixels.

  Size and layout (`{n, 3, side, side}` or `{n, side, side, 3}`) come from the model's only input with four dimensions.
  `ImageNet` networks need the options `imagenet_options/0`.
  """

  @schema [
    mean: [
      type: {:list, :number},
      default: [0.0, 0.0, 0.0],
      doc: "The mean subtracted from red, green and blue (0..1)."
    ],
    std: [
      type: {:list, :number},
      default: [1.0, 1.0, 1.0],
      doc: "The divisors applied after `mean:`."
    ],
    scale: [
      type: :number,
      default: 1 / 255,
      doc: "The factor for a channel's value, before `mean:`; 1 leaves 0..255."
    ],
    order: [type: {:in, [:rgb, :bgr]}, default: :rgb, doc: "The order of the channels."],
    fit: [
      type: {:in, [:crop, :pad]},
      default: :crop,
      doc: "How to fit an image that is not square: crop it to its middle, or pad it with black."
    ],
    side: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "The side of the input image, if the file does not fix it."
    ]
  ]

  Situ.Options.add_to_moduledoc(__MODULE__, @schema)

  alias Situ.{Error, Image, Tensor}
  alias Situ.Infer.{Model, Onnx, Patch}

  @enforce_keys [:name, :side, :glue, :fit]
  defstruct [:name, :side, :glue, :fit]

  @type t :: %__MODULE__{
          name: String.t(),
          side: pos_integer(),
          glue: Model.t(),
          fit: :crop | :pad
        }

  @doc "Returns the schema of the options, for modules that pass them on, with other default values."
  @spec schema(keyword()) :: Situ.Options.schema()
  def schema(defaults \\ []) do
    for {key, spec} <- @schema,
        do: {key, Keyword.put(spec, :default, Keyword.get(defaults, key, spec[:default]))}
  end

  @doc "Returns the normalization of networks that were trained on ImageNet."
  @spec imagenet_options() :: keyword()
  def imagenet_options, do: [mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225]]

  @doc """
  Builds the model's image input. `opts` may contain other options, which the calling module has validated. Errors:
  `:model_shape`, `:bad_option`.
  """
  @spec new(Model.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Model{} = model, opts \\ []) do
    with {:ok, opts} <-
           opts |> Keyword.take(Keyword.keys(@schema)) |> Situ.Options.validate(@schema),
         :ok <- check_normalization(opts),
         {:ok, name, layout, side} <- find_input(model, opts[:side]),
         {type, _shape} = model.inputs[name],
         {:ok, glue} <- build_glue(layout, type, side, opts),
         do: {:ok, %__MODULE__{name: name, side: side, glue: glue, fit: opts[:fit]}}
  end

  defp check_normalization(opts) do
    if length(opts[:mean]) == 3 and length(opts[:std]) == 3 and Enum.all?(opts[:std], &(&1 != 0)),
      do: :ok,
      else:
        {:error,
         Error.new(
           :bad_option,
           "mean: and std: must be three numbers each, and std: must not contain 0"
         )}
  end

  defp find_input(model, side) do
    ports =
      for {name, {type, {_, _, _, _} = shape}} when type in [:f32, :f16] <- model.inputs,
          do: {name, shape}

    case ports do
      [{name, {_, 3, h, w}}] -> check_square(name, :planes, h, w, side, model)
      [{name, {_, h, w, 3}}] -> check_square(name, :pixels, h, w, side, model)
      _ -> {:error, not_an_image(model)}
    end
  end

  defp check_square(name, layout, -1, -1, side, _model) when side != nil,
    do: {:ok, name, layout, side}

  defp check_square(name, layout, h, h, side, _model) when h > 0 and side in [nil, h],
    do: {:ok, name, layout, h}

  defp check_square(_name, _layout, _h, _w, _side, model), do: {:error, not_an_image(model)}

  defp not_an_image(model) do
    shapes =
      Enum.map_join(model.inputs, ", ", fn {name, {type, s}} ->
        "#{name}: #{type} #{inspect(s)}"
      end)

    Error.new(:model_shape, "model #{model.name} does not take one square image",
      why:
        "its inputs are #{shapes}; it must be f32 or f16 {n, 3, side, side} or {n, side, side, 3}",
      fix: "if the file leaves the size free, give side:; otherwise use Situ.Infer.OnnxModel"
    )
  end

  # ONNX Runtime also normalises and rearranges the pixels, since there may be a million numbers.
  defp build_glue(layout, type, side, opts) do
    {mean, std} =
      if opts[:order] == :bgr,
        do: {Enum.reverse(opts[:mean]), Enum.reverse(opts[:std])},
        else: {opts[:mean], opts[:std]}

    order = if opts[:order] == :bgr, do: [2, 1, 0], else: [0, 1, 2]
    perm = if layout == :planes, do: [0, 3, 1, 2], else: [0, 1, 2, 3]
    shape = if layout == :planes, do: {1, 3, side, side}, else: {1, side, side, 3}

    bytes =
      Onnx.encode(
        inputs: [{"picture", :f32, {1, side, side, 3}}],
        outputs: [{"input", type, shape}],
        constants: %{
          "order" => Tensor.from_list(order, :s64, {3}),
          "scale" => Tensor.from_list(Enum.map(std, &(opts[:scale] / &1)), :f32, {3}),
          "offset" => Tensor.from_list(Enum.zip_with(mean, std, &(-&1 / &2)), :f32, {3})
        },
        nodes: [
          {"Gather", ["picture", "order"], ["ordered"], [axis: 3]},
          {"Mul", ["ordered", "scale"], ["scaled"], []},
          {"Add", ["scaled", "offset"], ["moved"], []},
          {"Transpose", ["moved"], ["laid"], [perm: perm]},
          {"Cast", ["laid"], ["input"], [to: if(type == :f16, do: 10, else: 1)]}
        ]
      )

    Model.from_bytes(bytes, "image input", warm_up: 1, sessions: 1)
  end

  @doc "Returns the network's input for an image of an 8-bit format, and the patch that maps results back to the image."
  @spec to_tensor(t(), Image.t()) :: {:ok, Tensor.t(), Patch.t()} | {:error, Error.t()}
  def to_tensor(%__MODULE__{} = input, %Image{width: w, height: h} = image) do
    side = if input.fit == :pad, do: max(w, h), else: min(w, h)
    patch = Patch.from_square({(w - side) / 2, (h - side) / 2}, side / 1, input.side)

    with {:ok, pixels} <- Patch.cut_tensor(patch, image, 1.0, 0.0),
         {:ok, %{"input" => tensor}} <- Model.run(input.glue, %{"picture" => pixels}),
         do: {:ok, tensor, patch}
  end
end
