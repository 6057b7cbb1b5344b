defmodule Situ.Bridge.Ros.PointCloud2 do
  @moduledoc false
  # Converts `sensor_msgs/PointCloud2` to `Situ.PointCloud` and back. Pure.
  alias Situ.Bridge.Ros.Pixels
  alias Situ.PointCloud

  @float32 7

  @doc "Returns the cloud, or `:error` unless x, y and z are consecutive float32 fields (nearly always the case)."
  @spec from_message(map()) :: {:ok, PointCloud.t()} | :error
  def from_message(
        %{"is_bigendian" => false, "point_step" => step, "data" => data, "fields" => fields} = m
      )
      when is_binary(data) do
    at =
      for %{"name" => name, "offset" => at, "datatype" => kind} <- fields,
          into: %{},
          do: {name, {at, kind}}

    with %{"x" => {x, @float32}, "y" => {y, @float32}, "z" => {z, @float32}} <- at,
         true <- y == x + 4 and z == x + 8 and x + 12 <= step,
         {:ok, data} <- join_rows(data, m["height"], m["width"] * step, m["row_step"]),
         {:ok, cloud} <-
           PointCloud.new(
             Pixels.slice_every(data, step, x, 12),
             read_colors(data, step, at),
             read_values(data, step, at)
           ) do
      {:ok, cloud}
    else
      _ -> :error
    end
  end

  def from_message(_), do: :error

  # Rows may be padded after their points.
  defp join_rows(data, height, row, row) when byte_size(data) == height * row, do: {:ok, data}

  defp join_rows(data, height, row, stride)
       when row <= stride and byte_size(data) == height * stride,
       do: {:ok, Pixels.slice_every(data, stride, 0, row)}

  defp join_rows(_data, _height, _row, _stride), do: :error

  # The bytes are blue, green, red and one unused byte, whatever the declared type is.
  defp read_colors(data, step, fields) do
    case fields["rgb"] || fields["rgba"] do
      {at, _kind} when at + 4 <= step ->
        for <<b, g, r, _ <- Pixels.slice_every(data, step, at, 4)>>, into: <<>>, do: <<r, g, b>>

      _ ->
        nil
    end
  end

  defp read_values(data, step, fields) do
    case fields["intensity"] do
      {at, @float32} when at + 4 <= step -> Pixels.slice_every(data, step, at, 4)
      {at, 4} when at + 2 <= step -> integers_to_floats(Pixels.slice_every(data, step, at, 2), 16)
      {at, 2} when at + 1 <= step -> integers_to_floats(Pixels.slice_every(data, step, at, 1), 8)
      _ -> nil
    end
  end

  defp integers_to_floats(bytes, 8),
    do: for(<<x <- bytes>>, into: <<>>, do: <<x::little-float-32>>)

  defp integers_to_floats(bytes, 16),
    do: for(<<x::little-16 <- bytes>>, into: <<>>, do: <<x::little-float-32>>)

  @doc "Converts a cloud to the fields of a message."
  @spec to_message(PointCloud.t()) :: map()
  def to_message(%PointCloud{points: points, colors: colors} = cloud) do
    n = PointCloud.point_count(cloud)
    values = Map.get(cloud, :values)
    color_bytes = if colors, do: for(<<r, g, b <- colors>>, into: <<>>, do: <<b, g, r, 0>>)

    columns =
      for {bytes, size} <- [{points, 12}, {color_bytes, 4}, {values, 4}], bytes, do: {bytes, size}

    step = columns |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    data = interleave_columns(columns, n)

    names =
      ~w(x y z) ++ if(colors, do: ["rgb"], else: []) ++ if(values, do: ["intensity"], else: [])

    fields =
      for {name, i} <- Enum.with_index(names),
          do: %{"name" => name, "offset" => i * 4, "datatype" => @float32, "count" => 1}

    %{
      "height" => 1,
      "width" => n,
      "fields" => fields,
      "is_bigendian" => false,
      "point_step" => step,
      "row_step" => n * step,
      "data" => data,
      "is_dense" => false
    }
  end

  defp interleave_columns([{bytes, _}], _n), do: bytes

  defp interleave_columns(columns, n) do
    for i <- 0..(n - 1)//1,
        {bytes, size} <- columns,
        into: <<>>,
        do: binary_part(bytes, i * size, size)
  end
end
