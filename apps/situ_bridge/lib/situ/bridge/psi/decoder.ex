defmodule Situ.Bridge.Psi.Decoder do
  @moduledoc false
  # Decodes the bytes of a message to a term, following the plan of its type (`Situ.Bridge.Psi.Types`).
  #
  # Objects refer to other objects of the same message. A reference to a finished object is replaced by that object;
  # the terms share memory. A reference from inside the object itself (a cycle), or to an object that contains such a
  # reference, becomes `%{"$ref" => n}`. The referenced object then has the key "$id" => n; a list or another value
  # that is not a map becomes `%{"$id" => n, "$value" => value}`.
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.Bridge.Psi.{Bytes, Layout, Shapes, Types}

  @reference 0x4000_0000
  @new 0x8000_0000
  @typed 0xC000_0000
  @low_bits 0x3FFF_FFFF

  # Limits shared objects: a few bytes can refer to large objects that refer to large objects in turn. Copied, as
  # encoders do, they would exhaust the memory.
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
  Decodes a value. Returns an error with the reason if that fails. At most three bytes of padding may follow the
  value. With `rest: :any`, any number of bytes may follow it, since metadata may be in a buffer that is too long.
  """
  @spec decode(binary(), Types.handler(), Types.t(), keyword()) ::
          {:ok, term()} | {:error, String.t()}
  def decode(bytes, handler, types, opts \\ [])

  def decode(bytes, {:value, {:raw, layout}}, _types, opts) do
    size = Layout.size(layout)

    cond do
      byte_size(bytes) < size -> {:error, "#{byte_size(bytes)} bytes are too few for its type"}
      byte_size(bytes) > size + most(bytes, opts) -> left_over(byte_size(bytes) - size)
      true -> {:ok, Layout.read(layout, binary_part(bytes, 0, size))}
    end
  end

  def decode(bytes, handler, types, opts) do
    most = most(bytes, opts)

    with {:ok, value, %{needed: needed}} <- run(bytes, handler, %__MODULE__{types: types}, most),
         {:ok, value, _} <-
           named(bytes, handler, %__MODULE__{types: types, known: needed}, most, value),
         do: {:ok, value}
  end

  defp most(bytes, opts), do: if(opts[:rest] == :any, do: byte_size(bytes), else: 3)
  defp left_over(bytes), do: {:error, "#{bytes} bytes are left over"}

  @doc "Decodes a message of a stream with this .NET type name. Returns the same as `decode/4`."
  @spec message(binary(), String.t(), Types.handler(), Types.t()) ::
          {:ok, term()} | {:error, String.t()}
  def message(bytes, type_name, handler, types) do
    with {:error, why} <- decode(bytes, handler, types) do
      # Enums in plain structs have no schema, so their width is unknown. The right width uses all the bytes.
      Enum.find_value(types.others, {:error, why}, fn types ->
        with {:error, _} <- decode(bytes, Types.handler(types, type_name), types), do: nil
      end)
    end
  end

  # The objects that need an id are known only after decoding, so the bytes are decoded a second time.
  defp named(bytes, handler, state, most, value) do
    if MapSet.size(state.known) == 0,
      do: {:ok, value, state},
      else: run(bytes, handler, state, most)
  end

  # Decoding is deeply recursive, so errors are thrown from the inner functions and caught here.
  defp run(bytes, handler, state, most) do
    {value, rest, state} = read(handler, bytes, state)

    if byte_size(rest) <= most,
      do: {:ok, value, state},
      else: left_over(byte_size(rest))
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
      @new -> fail("an object has a type that no schema describes")
      _ -> fail("an object begins with bytes that are not a reference")
    end
  end

  defp read({:object, _plan}, _bytes, _state),
    do: fail("the data ends at the beginning of an object")

  defp resolve({:type, name}, state), do: Map.fetch!(state.types.by_name, name)
  defp resolve(plan, _state), do: plan

  defp typed(id, bytes, state) do
    case state.types.by_id do
      %{^id => plan} -> object(plan, state.types.names[id], bytes, state)
      _ -> fail("an object has the type number #{id}, which no schema describes")
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
        fail("a reference points to an object that does not exist yet")
    end
  end

  defp object(plan, type, bytes, %{next: id, nodes: nodes, refs: refs} = state) do
    state = %{state | next: id + 1, nodes: nodes + 1, objects: Map.put(state.objects, id, :open)}
    {value, rest, state} = content(plan, bytes, state)
    state = closed(plan, id, refs, state)
    value = value |> with_type(type, plan) |> with_id(id, state)

    # An object that contains references by number cannot be repeated in another place.
    done = if state.refs == refs, do: {value, state.nodes - nodes}, else: :open
    {value, rest, %{state | objects: Map.put(state.objects, id, done)}}
  end

  # The nodes of a linked list refer to each other and to the list. The list's items contain none of these references.
  defp closed({:fields, _, :linked}, id, refs, state) do
    needed = state.needed |> Enum.filter(&(&1 < id)) |> MapSet.new()
    %{state | refs: refs, needed: needed}
  end

  defp closed(_plan, _id, _refs, state), do: state

  # Adds the type of an object if the member's type does not determine it. Dictionaries are skipped, because their keys
  # are data.
  defp with_type(%{__struct__: _} = struct, _type, _plan), do: struct
  defp with_type(value, type, {:fields, _, :map}) when is_binary(type), do: put_type(value, type)
  defp with_type(value, type, {:raw, _}) when is_binary(type), do: put_type(value, type)
  defp with_type(value, _type, _plan), do: value

  defp put_type(value, type),
    do: if(is_map(value), do: Map.put(value, "$type", type), else: value)

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
      _ -> fail("the data ends within a value")
    end
  end

  defp content(:string, bytes, state) do
    case Bytes.string(bytes) do
      {:ok, text, rest} -> {text, rest, state}
      :error -> fail("the data ends within a string")
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
        fail("the data ends within an array")
    end
  end

  # Each element takes at least one byte, so a count larger than the number of bytes is invalid.
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
      {_method, rest, state} -> compressed(shape, members, rest, state)
    end
  end

  defp content({:fields, members, shape}, bytes, state), do: fields(members, shape, bytes, state)

  defp content(_plan, _bytes, _state),
    do: fail("the data ends within an array, or the length of an array is invalid")

  # The compressed image replaces the first five members; depth images have more members after it.
  defp compressed(shape, members, bytes, state) do
    kind = if shape == :image, do: "EncodedImage", else: "EncodedDepthImage"
    name = "Microsoft.Psi.Shared`1[[Microsoft.Psi.Imaging.#{kind}]]"

    case state.types.by_name do
      %{^name => plan} ->
        {picture, rest, state} = read({:object, plan}, bytes, state)
        {_, rest, state} = fields(Enum.drop(members, 5), :map, rest, state)
        {picture, rest, state}

      _ ->
        fail("an image is compressed in a way that no schema describes")
    end
  end

  defp fields(members, shape, bytes, state) do
    {values, {rest, state}} =
      Enum.map_reduce(members, {bytes, state}, fn {name, handler}, {bytes, state} ->
        {value, rest, state} = read(handler, bytes, state)
        {{name, value}, {rest, state}}
      end)

    {Shapes.value(shape, values), rest, state}
  end

  defp times(n, acc, fun) do
    Enum.map_reduce(1..n//1, acc, fn _, {bytes, state} ->
      {value, rest, state} = fun.(bytes, state)
      {value, {rest, state}}
    end)
  end
end
