defmodule Situ.Studio.Scene do
  @moduledoc false
  # Represents one message for the page's 3D view: a list of items of nine kinds, with binary
  # numeric data. `Situ.Studio.Frame` describes the kinds and their numbers.

  alias Situ.Studio.FrameSchema

  @enforce_keys [:kind, :count]
  defstruct [:kind, :count, meta: %{}, numbers: []]

  @kinds [:points, :lines, :boxes, :meshes, :texts, :quads, :frusta, :graphs, :voxels]
  @nan <<0, 0, 0xC0, 0x7F>>
  @largest 3.4e38

  @type kind ::
          :points | :lines | :boxes | :meshes | :texts | :quads | :frusta | :graphs | :voxels
  @typedoc "`meta` is encoded as JSON, `numbers` are copied unchanged."
  @type item :: %__MODULE__{
          kind: kind(),
          count: non_neg_integer(),
          meta: map(),
          numbers: [{atom(), iodata()}]
        }

  @doc """
  Creates an item with `count` elements of a kind.

      iex> item = Situ.Studio.Scene.new_item(:points, 1, [position: Situ.Studio.Scene.encode_floats([1.0, 2.0, 3.0])])
      iex> <<size::little-32, 0::32, json::binary-size(size), _::binary>> =
      ...>   IO.iodata_to_binary(Situ.Studio.Scene.pack([item]))
      iex> {:ok, %{"items" => [%{"kind" => "points", "count" => 1}]}} = Situ.JSON.decode(json)
  """
  @spec new_item(kind(), non_neg_integer(), [{atom(), iodata()}], map()) :: item()
  def new_item(kind, count, numbers, meta \\ %{}) when kind in @kinds,
    do: %__MODULE__{kind: kind, count: count, numbers: numbers, meta: meta}

  @doc """
  Encodes numbers as 32-bit floats. Any other term becomes NaN, which the page skips and counts.

      iex> Situ.Studio.Scene.encode_floats([1, :nan]) |> IO.iodata_to_binary()
      <<0, 0, 128, 63, 0, 0, 192, 127>>
  """
  @spec encode_floats([term()]) :: iodata()
  def encode_floats(values), do: for(value <- values, into: <<>>, do: encode_float(value))

  defp encode_float(x) when is_number(x) and x <= @largest and x >= -@largest,
    do: <<x::little-float-32>>

  defp encode_float(_other), do: @nan

  @doc "Encodes 32-bit unsigned integers."
  @spec encode_integers([0..4_294_967_295]) :: binary()
  def encode_integers(values), do: for(value <- values, into: <<>>, do: <<value::little-32>>)

  # The maximum total size of a page's mesh cache, and the minimum size of a mesh that is cached, in bytes.
  @most_kept 67_108_864
  @least_kept 1_024

  @doc """
  Replaces the numbers of meshes that the page has cached with their names. `kept` maps the names of cached meshes to
  their sizes. A new mesh is sent with its numbers and a name to cache it under, if the cache has room. If `kept` is
  `nil`, nothing is cached.

      iex> mesh = Situ.Studio.Scene.new_item(:meshes, 1, position: <<0::9600>>, index: <<0::96>>)
      iex> {[%{numbers: [_, _], meta: %{"keep" => name}}], kept} = Situ.Studio.Scene.cache_meshes([mesh], %{})
      iex> {[%{numbers: [], meta: %{"held" => ^name}}], ^kept} = Situ.Studio.Scene.cache_meshes([mesh], kept)
      iex> map_size(kept)
      1
  """
  @spec cache_meshes([item()], kept | nil) :: {[item()], kept | nil}
        when kept: %{binary() => pos_integer()}
  def cache_meshes(items, nil), do: {items, nil}
  def cache_meshes(items, kept), do: Enum.map_reduce(items, kept, &cache_mesh/2)

  defp cache_mesh(%{kind: :meshes, numbers: numbers} = item, kept) do
    size = IO.iodata_length(Keyword.values(numbers))
    name = if size >= @least_kept, do: mesh_name(numbers)

    cond do
      name == nil ->
        {item, kept}

      is_map_key(kept, name) ->
        {%{item | numbers: [], meta: Map.put(item.meta, "held", name)}, kept}

      Enum.sum(Map.values(kept)) + size > @most_kept ->
        {item, kept}

      true ->
        {%{item | meta: Map.put(item.meta, "keep", name)}, Map.put(kept, name, size)}
    end
  end

  defp cache_mesh(item, kept), do: {item, kept}

  defp mesh_name(numbers) do
    sizes = for {_, bytes} <- numbers, do: <<IO.iodata_length(bytes)::64>>
    Base.encode16(:crypto.hash(:sha256, [sizes | Keyword.values(numbers)]))
  end

  @doc "Encodes items for the page: the size of a JSON text (32 bits, then 32 zero bits), the text, the numbers."
  @spec pack([item()], [String.t()]) :: iodata()
  def pack(items, problems \\ []) do
    {rows, {_, blobs}} = Enum.map_reduce(items, {0, []}, &pack_item/2)
    json = Situ.JSON.encode(%{"items" => rows, "problems" => problems})
    size = byte_size(json)
    [FrameSchema.encode(:scene, %{bytes: size}), json, padding_bytes(size), Enum.reverse(blobs)]
  end

  # Computes the offsets of the item's numbers after the JSON text, aligned to 8 bytes.
  defp pack_item(item, {at, blobs}) do
    {parts, {at, blobs}} =
      Enum.map_reduce(item.numbers, {at, blobs}, fn {name, bytes}, {at, blobs} ->
        size = IO.iodata_length(bytes)
        padded = [bytes, padding_bytes(size)]
        {{Atom.to_string(name), [at, size]}, {at + IO.iodata_length(padded), [padded | blobs]}}
      end)

    own = %{"kind" => Atom.to_string(item.kind), "count" => item.count, "at" => Map.new(parts)}
    {Map.merge(item.meta, own), {at, blobs}}
  end

  defp padding_bytes(size), do: <<0::size(rem(8 - rem(size, 8), 8) * 8)>>
end
