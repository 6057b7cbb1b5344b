defmodule Situ.Bridge.Psi.Decoder do
  @moduledoc false
  # A message's bytes as a term, by the plan of its type (`Situ.Bridge.Psi.Types`).
  #
  # Objects refer to objects of the same message. One that was finished before is repeated: terms share it. One that
  # is met inside of itself (a cycle), or one that holds such a reference, is `%{"$ref" => n}` and the object meant
  # has the key "$id" => n (a list or other value is then `%{"$id" => n, "$value" => value}`).
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.Bridge.Psi.{Bytes, Layout, Shapes, Types}

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

  @doc "A message of a stream of the type with this .NET name, as `decode/4`."
  @spec message(binary(), String.t(), Types.handler(), Types.t()) ::
          {:ok, term()} | {:error, String.t()}
  def message(bytes, type_name, handler, types) do
    with {:error, why} <- decode(bytes, handler, types) do
      # Enums in plain structs have no schema: the width with which all bytes have a meaning is theirs.
      Enum.find_value(types.others, {:error, why}, fn types ->
        with {:error, _} <- decode(bytes, Types.handler(types, type_name), types), do: nil
      end)
    end
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
    state = closed(plan, id, refs, state)
    value = value |> with_type(type, plan) |> with_id(id, state)

    # An object that holds references by number cannot be repeated elsewhere.
    done = if state.refs == refs, do: {value, state.nodes - nodes}, else: :open
    {value, rest, %{state | objects: Map.put(state.objects, id, done)}}
  end

  # The nodes of a linked list refer to one another and to the list: of that nothing is left in its items.
  defp closed({:fields, _, :linked}, id, refs, state) do
    needed = state.needed |> Enum.filter(&(&1 < id)) |> MapSet.new()
    %{state | refs: refs, needed: needed}
  end

  defp closed(_plan, _id, _refs, state), do: state

  # Which of several types an object has is told where the member does not. Dictionaries have keys of their own.
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
      {_method, rest, state} -> compressed(shape, members, rest, state)
    end
  end

  defp content({:fields, members, shape}, bytes, state), do: fields(members, shape, bytes, state)
  defp content(_plan, _bytes, _state), do: fail("it ends within an array, or its length is wrong")

  # The compressed picture stands for the first five members; depth images go on behind it.
  defp compressed(shape, members, bytes, state) do
    kind = if shape == :image, do: "EncodedImage", else: "EncodedDepthImage"
    name = "Microsoft.Psi.Shared`1[[Microsoft.Psi.Imaging.#{kind}]]"

    case state.types.by_name do
      %{^name => plan} ->
        {picture, rest, state} = read({:object, plan}, bytes, state)
        {_, rest, state} = fields(Enum.drop(members, 5), :map, rest, state)
        {picture, rest, state}

      _ ->
        fail("it is compressed in a way that no schema describes")
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
