defmodule Situ.Image.Nx do
  @moduledoc """
  Converts images and audio to Nx tensors and back.

      {:ok, tensor} = Situ.Image.Nx.to_nx(image)          # u8[height][width][channels], no copy without padding
      {:ok, image} = Situ.Image.Nx.to_image(tensor, :rgb24)
      {:ok, samples} = Situ.Image.Nx.to_nx(buffer)        # s16[frames][channels]

  Nx is an optional dependency that is looked up at run time; without it, functions return the error `:nx_missing`.
  Tensors use the machine's byte order. All machines that Situ supports are little-endian, as are Situ's structs.
  """
  @compile {:no_warn_undefined, [Nx]}
  alias Situ.{AudioBuffer, AudioFormat, DepthImage, Error, Image}
  alias Situ.Image.Format

  @types %{u8: {:u, 8}, s16: {:s, 16}, s32: {:s, 32}, f32: {:f, 32}, f64: {:f, 64}}

  @doc """
  Converts an image (height x width x channels), a depth image (height x width) or audio (frames x channels) to a
  tensor. Nx has no type for `:s24` audio, so reformat it first.
  """
  @spec to_nx(Image.t() | DepthImage.t() | AudioBuffer.t()) ::
          {:ok, struct()} | {:error, Error.t()}
  def to_nx(%Image{} = image) do
    with {:ok, image} <- Image.validate(image) do
      channels = length(Format.channels(image.format))
      type = {:u, Format.bits_per_channel(image.format)}
      build_tensor(Image.pixel_bytes(image), type, {image.height, image.width, channels})
    end
  end

  def to_nx(%DepthImage{} = depth) do
    with {:ok, depth} <- DepthImage.validate(depth) do
      image = DepthImage.to_gray16(depth)
      build_tensor(Image.pixel_bytes(image), {:u, 16}, {image.height, image.width})
    end
  end

  def to_nx(%AudioBuffer{format: %{sample: :s24}}) do
    {:error, Error.new(:bad_audio, "Nx has no 24-bit tensors", fix: "reformat to :s32 or :f32")}
  end

  def to_nx(%AudioBuffer{} = buffer) do
    with {:ok, buffer} <- AudioBuffer.validate(buffer) do
      type = Map.fetch!(@types, buffer.format.sample)
      build_tensor(buffer.data, type, {AudioBuffer.frame_count(buffer), buffer.format.channels})
    end
  end

  @doc "Converts a tensor (height x width x channels, or height x width for grey) to an image of this format."
  @spec to_image(struct(), Format.t()) :: Image.result()
  def to_image(tensor, format) do
    with {:ok, nx} <- fetch_nx() do
      type = {:u, Format.bits_per_channel(format)}
      channels = length(Format.channels(format))

      case {apply(nx, :type, [tensor]), apply(nx, :shape, [tensor])} do
        {^type, {height, width, ^channels}} ->
          image_from_tensor(nx, tensor, {width, height}, format)

        {^type, {height, width}} when channels == 1 ->
          image_from_tensor(nx, tensor, {width, height}, format)

        other ->
          {:error, mismatch_error(other, format, type, channels)}
      end
    end
  end

  @doc "Converts a tensor (frames x channels, or frames) to audio. Its type must match a sample type."
  @spec to_audio(struct(), pos_integer()) :: AudioBuffer.result()
  def to_audio(tensor, rate) do
    with {:ok, nx} <- fetch_nx(),
         {:ok, sample} <- fetch_sample_type(apply(nx, :type, [tensor])) do
      channels =
        if tuple_size(shape = apply(nx, :shape, [tensor])) == 2, do: elem(shape, 1), else: 1

      format = %AudioFormat{rate: rate, channels: channels, sample: sample}
      AudioBuffer.new(format: format, data: apply(nx, :to_binary, [tensor]))
    end
  end

  defp fetch_sample_type(type) do
    case Enum.find(@types, fn {_, t} -> t == type end) do
      {sample, _} -> {:ok, sample}
      nil -> {:error, Error.new(:bad_audio, "no sample type matches #{inspect(type)}")}
    end
  end

  defp image_from_tensor(nx, tensor, {width, height}, format),
    do:
      Image.new(
        width: width,
        height: height,
        format: format,
        data: apply(nx, :to_binary, [tensor])
      )

  defp build_tensor(binary, type, shape) do
    with {:ok, nx} <- fetch_nx(),
         do: {:ok, apply(nx, :reshape, [apply(nx, :from_binary, [binary, type]), shape])}
  end

  defp fetch_nx do
    if Code.ensure_loaded?(Nx) do
      {:ok, Nx}
    else
      {:error,
       Error.new(:nx_missing, "Nx is not loaded",
         fix: "add :nx to the host application's dependencies"
       )}
    end
  end

  defp mismatch_error({type, shape}, format, wanted, channels) do
    Error.new(
      :bad_format,
      "a tensor of type #{inspect(type)} and shape #{inspect(shape)} cannot become #{inspect(format)}",
      why: "#{inspect(format)} needs height x width x #{channels} of type #{inspect(wanted)}"
    )
  end
end
