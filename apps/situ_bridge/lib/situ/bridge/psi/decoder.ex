defmodule Situ.Bridge.Psi.Decoder do
  @moduledoc false
  # A message's bytes as a term, by the plan of its type (`Situ.Bridge.Psi.Types`).
  #
  # Objects refer to objects of the same message. One that was finished before is repeated: terms share it. One that
  # is met inside of itself (a cycle), or one that holds such a reference, is `%{"$ref" => n}` and the object meant
  # has the key "$id" => n (a list or other value is then `%{"$id" => n, "$value" => value}`).
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.Bridge.Psi.{Bytes, Layout, Media, Types}

  @reference 0x4000_0000
  @new 0x8000_0000
  @typed 0xC000_0000
  @low_bits 0x3FFF_FFFF

  # A few bytes can refer to large objects, which refer to large objects ...: copied out, they would fill any memory.
  @most_shared 1_000_000

  # CompressionMethod.None and DepthCompressionMethod.None
  @uncompressed 2

  defstruct [
    :types,
    objects: %{},
    next: 0,
    nodes: 0,
    refs: 0,
    needed: MapSet.new(),
    known: MapSet.new()
  ]

  @doc """
  The value, or why there is none. No more than three bytes of padding may follow it, with `rest: :any` anything
  (metadata are kept in a buffer that may be longer).
  """
  @spec decode(binary(), Types.handler(), Types.t(), keyword()) ::
          {:ok, term()} | {:error, String.t()}
  def decode(bytes, handler, types, opts \\ [])

  def decode(bytes, {:value, {:raw, layout}}, _types, _opts) do
    size = Layout.size(layout)

    if byte_size(bytes) >= size,
      do: {:ok, Layout.read(layout, binary_part(bytes, 0, size))},
      else: {:error, "#{byte_size(bytes)} bytes are too few for its type"}
  end

  def decode(bytes, handler, types, opts) do
    most = if opts[:rest] == :any, do: byte_size(bytes), else: 3

    with {:ok, value, %{needed: needed}} <- run(bytes, handler, %__MODULE__{types: types}, most),
         {:ok, value, _} <-
           named(bytes, handler, %__MODULE__{types: types, known: needed}, most, value),
         do: {:ok, value}
  end

  # Which objects need a name is known at the end: with names they are read once more.
  defp named(bytes, handler, state, most, value) do
    if MapSet.size(state.known) == 0,
      do: {:ok, value, state},
      else: run(bytes, handler, state, most)
  end

  # Reading goes deep into itself; what is wrong with the bytes is thrown out of there.
  defp run(bytes, handler, state, most) do
    {value, rest, state} = read(handler, bytes, state)

    if byte_size(rest) <= most,
      do: {:ok, value, state},
      else: {:error, "#{byte_size(rest)} bytes are left over"}
  catch
    {:not_psi, why} -> {:error, why}
  end

  defp fail(why), do: throw({:not_psi, why})

  defp read({:value, plan}, bytes, state), do: content(resolve(plan, state), bytes, state)

  defp read({:object, plan}, <<prefix::little-32, rest::binary>>, state) do
    case prefix &&& @typed do
      0 when prefix == 0 -> {nil, rest, state}
      @reference -> reference(prefix &&& @low_bits, rest, state)
      @new when plan != nil -> object(resolve(plan, state), nil, rest, state)
      @typed -> typed(prefix &&& @low_bits, rest, state)
      @new -> fail("an object of a type that no schema describes")
      _ -> fail("bytes that are no reference where an object begins")
    end
  end

  defp read({:object, _plan}, _bytes, _state), do: fail("it ends where an object begins")

  defp resolve({:type, name}, state), do: Map.fetch!(state.types.by_name, name)
  defp resolve(plan, _state), do: plan

  defp typed(id, bytes, state) do
    case state.types.by_id do
      %{^id => plan} -> object(plan, state.types.names[id], bytes, state)
      _ -> fail("an object of the type number #{id}, which no schema describes")
    end
  end

  defp reference(id, rest, state) do
    case state.objects do
      %{^id => {value, nodes}} when nodes + state.nodes < @most_shared ->
        {value, rest, %{state | nodes: state.nodes + nodes}}

      %{^id => _open_or_large} ->
        needed = MapSet.put(state.needed, id)
        {%{"$ref" => id}, rest, %{state | needed: needed, refs: state.refs + 1}}

      _ ->
        fail("a reference to an object that has not come yet")
    end
  end

  defp object(plan, type, bytes, %{next: id, nodes: nodes, refs: refs} = state) do
    state = %{state | next: id + 1, nodes: nodes + 1, objects: Map.put(state.objects, id, :open)}
    {value, rest, state} = content(plan, bytes, state)
    value = value |> with_type(type) |> with_id(id, state)

    # An object that holds references by number cannot be repeated elsewhere.
    done = if state.refs == refs, do: {value, state.nodes - nodes}, else: :open
    {value, rest, %{state | objects: Map.put(state.objects, id, done)}}
  end

  # Which of several types an object has is told where the member does not.
  defp with_type(%{__struct__: _} = struct, _type), do: struct

  defp with_type(value, type)
       when is_map(value) and is_binary(type) and not is_map_key(value, :data),
       do: Map.put(value, "$type", type)

  defp with_type(value, _type), do: value

  defp with_id(value, id, state) do
    cond do
      not MapSet.member?(state.known, id) -> value
      is_map(value) and not is_struct(value) -> Map.put(value, "$id", id)
      true -> %{"$id" => id, "$value" => value}
    end
  end

  defp content({:raw, layout}, bytes, state) do
    size = Layout.size(layout)

    case bytes do
      <<value::binary-known(size), rest::binary>> -> {Layout.read(layout, value), rest, state}
      _ -> fail("it ends within a value")
    end
  end

  defp content(:string, bytes, state) do
    case Bytes.string(bytes) do
      {:ok, text, rest} -> {text, rest, state}
      :error -> fail("it ends within a string")
    end
  end

  defp content(:bytes, <<n::little-signed-32, data::binary-size(n), rest::binary>>, state)
       when n >= 0,
       do: {data, rest, state}

  defp content({:raw_array, layout}, <<n::little-signed-32, rest::binary>>, state) when n >= 0 do
    size = n * Layout.size(layout)

    case rest do
      <<values::binary-known(size), rest::binary>> ->
        {Layout.read_all(layout, values), rest, %{state | nodes: state.nodes + n}}

      _ ->
        fail("it ends within an array")
    end
  end

  # Each element takes a byte at least: a count beyond that is a lie.
  defp content(:strings, <<n::little-signed-32, rest::binary>>, state)
       when n >= 0 and n <= byte_size(rest) do
    {values, {rest, state}} = times(n, {rest, state}, &content(:string, &1, &2))
    {values, rest, state}
  end

  defp content({:array, handler}, <<n::little-signed-32, rest::binary>>, state)
       when n >= 0 and n <= byte_size(rest) do
    {values, {rest, state}} = times(n, {rest, state}, &read(handler, &1, &2))
    {values, rest, %{state | nodes: state.nodes + n}}
  end

  defp content({:fields, [{"compression", handler} | members], shape}, bytes, state)
       when shape in [:image, :depth_image] do
    case read(handler, bytes, state) do
      {@uncompressed, rest, state} -> fields(members, shape, rest, state)
      {_method, rest, state} -> compressed(shape, rest, state)
    end
  end

  defp content({:fields, members, shape}, bytes, state), do: fields(members, shape, bytes, state)
  defp content(_plan, _bytes, _state), do: fail("it ends within an array, or its length is wrong")

  defp compressed(shape, bytes, state) do
    kind = if shape == :image, do: "EncodedImage", else: "EncodedDepthImage"
    name = "Microsoft.Psi.Shared`1[[Microsoft.Psi.Imaging.#{kind}]]"

    case state.types.by_name do
      %{^name => plan} -> read({:object, plan}, bytes, state)
      _ -> fail("it is compressed in a way that no schema describes")
    end
  end

  defp fields(members, shape, bytes, state) do
    {values, {rest, state}} =
      Enum.map_reduce(members, {bytes, state}, fn {name, handler}, {bytes, state} ->
        {value, rest, state} = read(handler, bytes, state)
        {{name, value}, {rest, state}}
      end)

    {shaped(shape, values), rest, state}
  end

  defp times(n, acc, fun) do
    Enum.map_reduce(1..n//1, acc, fn _, {bytes, state} ->
      {value, rest, state} = fun.(bytes, state)
      {value, {rest, state}}
    end)
  end

  defp shaped(:list, [{_, items}, {_, size} | _])
       when is_list(items) and is_integer(size) and size >= 0,
       do: Enum.take(items, size)

  defp shaped(:dictionary, [_comparer, {_, pairs}]) when is_list(pairs) do
    Map.new(pairs, fn
      %{"key" => key, "value" => value} -> {key, value}
      _ -> fail("a dictionary of what are no pairs")
    end)
  end

  defp shaped(:old_dictionary, fields) do
    case Map.new(fields) do
      %{"entries" => entries} when is_list(entries) ->
        entries |> Enum.filter(&used?/1) |> Map.new(&{&1["key"], &1["value"]})

      %{"_entries" => entries} when is_list(entries) ->
        entries |> Enum.filter(&used?/1) |> Map.new(&{&1["key"], &1["value"]})

      %{} ->
        %{}
    end
  end

  defp shaped(:nullable, [{_, has?}, {_, value}]), do: if(has?, do: value)
  defp shaped(:tuple, fields), do: fields |> Enum.map(&elem(&1, 1)) |> List.to_tuple()
  defp shaped(:shared, [{_, inner}]), do: inner
  defp shaped(:map, fields), do: Map.new(fields)
  defp shaped(shape, fields), do: Media.value(shape, Map.new(fields))

  # Places of a hash table that hold nothing have a negative hash (.NET Framework) or link (.NET).
  defp used?(%{"next" => next, "key" => key} = entry),
    do: Map.get(entry, "hashCode", 0) >= 0 and next >= -1 and key != nil

  defp used?(_), do: false
end
