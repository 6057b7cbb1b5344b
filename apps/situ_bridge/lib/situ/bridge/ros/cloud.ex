defmodule Situ.Bridge.Ros.Cloud do
  @moduledoc false
  # `sensor_msgs/PointCloud2` as a `Situ.PointCloud` and back. Pure.
  alias Situ.Bridge.Ros.Pixels
  alias Situ.PointCloud

  @float32 7

  @doc "The cloud, when x, y and z are float32 and follow each other, as they nearly always are; else `:error`."
  @spec from(map()) :: {:ok, PointCloud.t()} | :error
  def from(
        %{"is_bigendian" => false, "point_step" => step, "data" => data, "fields" => fields} = m
      )
      when is_binary(data) do
    at =
      for %{"name" => name, "offset" => at, "datatype" => kind} <- fields,
          into: %{},
          do: {name, {at, kind}}

    with %{"x" => {x, @float32}, "y" => {y, @float32}, "z" => {z, @float32}} <- at,
         true <- y == x + 4 and z == x + 8 and x + 12 <= step,
         {:ok, data} <- rows(data, m["height"], m["width"] * step, m["row_step"]),
         {:ok, cloud} <- PointCloud.new(Pixels.every(data, step, x, 12), colors(data, step, at)) do
      {:ok, cloud}
    else
      _ -> :error
    end
  end

  def from(_), do: :error

  # Rows may be longer than their points.
  defp rows(data, height, row, row) when byte_size(data) == height * row, do: {:ok, data}

  defp rows(data, height, row, stride) when row <= stride and byte_size(data) == height * stride,
    do: {:ok, Pixels.every(data, stride, 0, row)}

  defp rows(_data, _height, _row, _stride), do: :error

  # Blue, green, red and a byte of nothing, whatever the type is called.
  defp colors(data, step, fields) do
    case fields["rgb"] || fields["rgba"] do
      {at, _kind} when at + 4 <= step ->
        for <<b, g, r, _ <- Pixels.every(data, step, at, 4)>>, into: <<>>, do: <<r, g, b>>

      _ ->
        nil
    end
  end

  @doc "A cloud as the message's members."
  @spec to(PointCloud.t()) :: map()
  def to(%PointCloud{colors: colors} = cloud) do
    n = PointCloud.count(cloud)
    {step, data} = if colors, do: {16, woven(cloud.points, colors, [])}, else: {12, cloud.points}
    names = if colors, do: ~w(x y z rgb), else: ~w(x y z)

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

  defp woven(<<point::binary-12, points::binary>>, <<r, g, b, colors::binary>>, all),
    do: woven(points, colors, [[point, b, g, r, 0] | all])

  defp woven("", "", all), do: all |> Enum.reverse() |> IO.iodata_to_binary()
end
