defmodule Situ.Nx.Conversion do
  @moduledoc false
  # Conversions between Situ's types and tensors. `Situ.Nx` lists them.
  alias Situ.{AudioBuffer, Columns, DepthImage, Image, Tensor}

  @spec to_nx(term()) :: Nx.Tensor.t()
  def to_nx(%Nx.Tensor{} = tensor), do: tensor
  def to_nx(%Tensor{} = tensor), do: Tensor.to_nx(tensor)
  def to_nx(number) when is_number(number), do: Nx.tensor(number)
  def to_nx([_ | _] = numbers), do: Nx.tensor(numbers)

  def to_nx(%Image{} = image) do
    {channels, type} = pixel_layout(image.format)
    shape = {image.height, image.width, channels}
    data = remove_padding(image, image.width * pixel_size(channels, type))
    tensor = data |> Nx.from_binary(type) |> Nx.reshape(shape)
    if channels == 1, do: Nx.squeeze(tensor, axes: [2]), else: tensor
  end

  def to_nx(%DepthImage{} = image),
    do:
      image
      |> remove_padding(image.width * 2)
      |> Nx.from_binary(:u16)
      |> Nx.reshape({image.height, image.width})

  def to_nx(%AudioBuffer{format: format, data: data}) do
    {type, data} = samples(format.sample, data)
    tensor = Nx.from_binary(data, type)
    Nx.reshape(tensor, {div(Nx.size(tensor), format.channels), format.channels})
  end

  def to_nx(%Columns{kind: :integer, values: values}), do: Nx.from_binary(values, :s64)
  def to_nx(%Columns{kind: :float, values: values}), do: Nx.from_binary(values, :f64)
  def to_nx(%Columns{kind: :boolean, values: values}), do: Nx.from_binary(values, :u8)

  def to_nx(other) do
    raise Situ.Error.new(:no_tensor, "cannot convert #{inspect(other, limit: 5)} to a tensor",
            why: "only tensors, images, audio, columns and numbers have one",
            fix: "convert the data with the option convert:"
          )
  end

  @spec from_nx(Nx.Tensor.t(), struct() | nil) :: struct()
  def from_nx(tensor, nil), do: Tensor.from_nx(tensor)

  def from_nx(tensor, like) do
    like_tensor = to_nx(like)

    if Nx.shape(tensor) != Nx.shape(like_tensor) or Nx.type(tensor) != Nx.type(like_tensor),
      do: raise(mismatch_error(tensor, like_tensor, like))

    put_data(like, Nx.to_binary(tensor))
  end

  defp put_data(%Columns{} = columns, bytes), do: Columns.put_values(columns, bytes, columns.kind)
  defp put_data(%{stride: _} = image, bytes), do: %{image | data: bytes, stride: row_size(image)}
  defp put_data(like, bytes), do: %{like | data: bytes}

  defp mismatch_error(tensor, like_tensor, like) do
    Situ.Error.new(
      :bad_tensor,
      "cannot make a #{inspect(like.__struct__)} of a tensor #{inspect(Nx.shape(tensor))} #{inspect(Nx.type(tensor))}",
      why: "it must be #{inspect(Nx.shape(like_tensor))} #{inspect(Nx.type(like_tensor))}",
      fix: "use Nx.as_type/2 and Nx.reshape/2, or from_nx/1 for a Situ.Tensor"
    )
  end

  defp row_size(%DepthImage{width: width}), do: width * 2

  defp row_size(%Image{} = image) do
    {channels, type} = pixel_layout(image.format)
    image.width * pixel_size(channels, type)
  end

  defp pixel_size(channels, :u8), do: channels
  defp pixel_size(channels, :u16), do: channels * 2

  defp pixel_layout(format) do
    channels = length(Image.Format.channels(format))
    size = div(Image.Format.bytes_per_pixel(format), channels)
    {channels, if(size == 2, do: :u16, else: :u8)}
  end

  defp remove_padding(%{stride: stride, data: data, height: height}, row) when stride == row,
    do: binary_part(data, 0, row * height)

  defp remove_padding(%{stride: stride, data: data, height: height}, row),
    do: for(y <- 0..(height - 1), into: <<>>, do: binary_part(data, y * stride, row))

  # Nx has no integers of 24 bits.
  defp samples(:s24, data),
    do: {:s32, for(<<x::little-signed-24 <- data>>, into: <<>>, do: <<x::native-signed-32>>)}

  defp samples(type, data), do: {type, data}
end
