defmodule Situ.Studio.Link do
  @moduledoc false
  # Encodes a layout as part of a URL, so that a link shows the sender's layout even if it was not
  # saved.
  alias Situ.Error
  alias Situ.Studio.Layout

  @max_code 8_000
  @max_json 200_000

  @doc """
  Encodes a layout as a URL-safe string.

      iex> layout = Situ.Studio.Layout.new("mine")
      iex> {:ok, layout, _} = Situ.Studio.Layout.add_stream(layout, "A.level", "line", :plot, "")
      iex> code = Situ.Studio.Link.encode(layout)
      iex> Situ.Studio.Link.decode(code) == {:ok, layout}
      true
      iex> {:error, error} = Situ.Studio.Link.decode("nonsense")
      iex> error.code
      :bad_link
  """
  @spec encode(Layout.t()) :: String.t()
  def encode(%Layout{} = layout) do
    layout |> Layout.Json.to_json() |> :zlib.zip() |> Base.url_encode64(padding: false)
  end

  @doc "Decodes a layout; returns an error if the code is damaged or too long."
  @spec decode(String.t()) :: {:ok, Layout.t()} | {:error, Error.t()}
  def decode(code) when is_binary(code) and byte_size(code) <= @max_code do
    with {:ok, zipped} <- Base.url_decode64(code, padding: false),
         {:ok, json} <- inflate_code(zipped) do
      Layout.Json.parse_json(json)
    else
      _ -> invalid_link()
    end
  end

  def decode(_), do: invalid_link()

  # Inflating in steps limits the size of the result, which a small code could make very large.
  defp inflate_code(zipped) do
    z = :zlib.open()

    try do
      :zlib.inflateInit(z, -15)
      inflate_chunks(z, :zlib.safeInflate(z, zipped), "")
    rescue
      ErlangError -> :error
    after
      :zlib.close(z)
    end
  end

  defp inflate_chunks(_z, {:finished, part}, json), do: append_bounded(json, part)

  defp inflate_chunks(z, {:continue, part}, json) do
    case append_bounded(json, part) do
      {:ok, json} -> inflate_chunks(z, :zlib.safeInflate(z, []), json)
      :error -> :error
    end
  end

  defp append_bounded(json, part) do
    json = json <> IO.iodata_to_binary(part)
    if byte_size(json) <= @max_json, do: {:ok, json}, else: :error
  end

  defp invalid_link,
    do: {:error, Error.new(:bad_link, "the layout in this address cannot be read")}
end
