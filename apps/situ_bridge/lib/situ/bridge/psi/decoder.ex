defmodule Situ.Bridge.Psi.Decoder do
  @moduledoc false
  # Decodes the bytes of a message to a term, following the plan of its type (`Situ.Bridge.Psi.TypePlans`).
  #
  # Objects refer to other objects of the same message. A reference to a finished object is replaced by that object;
  # the terms share memory. A reference from inside the object itself (a cycle), or to an object that contains such a
  # reference, becomes `%{"$ref" => n}`. The referenced object then has the key "$id" => n; a list or another value
  # that is not a map becomes `%{"$id" => n, "$value" => value}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.Bridge.Psi.{Bytes, Layout, Collections, TypePlans}

  @reference 0x4000_0000
  @new 0x8000_0000
  @typed 0xC000_0000
  @low_bits 0x3FFF_FFFF

  # Limits shared objects: a few bytes can refer to large objects that refer to large objects in turn. Copied, as
  # encoders do, they would exhaust the memory.
  @max_shared 1_000_000

  # CompressionMethod.None and DepthCompressionMethod.None
  @uncompressed 2

  defstruct [
    :types,
    objects: %{},
    next: 0,
    nodes: 0,
    refs: 0,
    referenced_ids: MapSet.new(),
    shared_ids: MapSet.new()
  ]

  @doc """
  Decodes a value. Returns an error with the reason if that fails. At most three bytes of padding may follow the
  value. With `rest: :any`, any number of bytes may follow it, since metadata may be in a buffer that is too long.
  """
  @spec decode(binary(), TypePlans.handler(), TypePlans.t(), keyword()) ::
          {:ok, term()} | {:error, String.t()}
  def decode(bytes, handler, types, opts \\ [])

  def decode(bytes, {:value, {:raw, layout}}, _types, opts) do
    size = Layout.value_size(layout)

    cond do
      byte_size(bytes) < size ->
        {:error, "#{byte_size(bytes)} bytes are too few for its type"}

      byte_size(bytes) > size + max_padding(bytes, opts) ->
        left_over_error(byte_size(bytes) - size)

      true ->
        {:ok, Layout.read_value(layout, binary_part(bytes, 0, size))}
    end
  end

  def decode(bytes, handler, types, opts) do
    max = max_padding(bytes, opts)

    with {:ok, value, %{referenced_ids: ids}} <-
           decode_bytes(bytes, handler, %__MODULE__{types: types}, max),
         {:ok, value, _} <-
           decode_with_ids(bytes, handler, %__MODULE__{types: types, shared_ids: ids}, max, value),
         do: {:ok, value}
  end

  defp max_padding(bytes, opts), do: if(opts[:rest] == :any, do: byte_size(bytes), else: 3)
  defp left_over_error(bytes), do: {:error, "#{bytes} bytes are left over"}

  @doc "Decodes a message of a stream with this .NET type name. Returns the same as `decode/4`."
  @spec decode_message(binary(), String.t(), TypePlans.handler(), TypePlans.t()) ::
          {:ok, term()} | {:error, String.t()}
  def decode_message(bytes, type_name, handler, types) do
    with {:error, why} <- decode(bytes, handler, types) do
      # Enums in plain structs have no schema, so their width is unknown. The right width uses all the bytes.
      Enum.find_value(types.others, {:error, why}, fn types ->
        with {:error, _} <- decode(bytes, TypePlans.handler(types, type_name), types), do: nil
      end)
    end
  end

  # The objects that need an id are known only after decoding, so the bytes are decoded a second time.
  defp decode_with_ids(bytes, handler, state, max, value) do
    if MapSet.size(state.shared_ids) == 0,
      do: {:ok, value, state},
      else: decode_bytes(bytes, handler, state, max)
  end

  # Decoding is deeply recursive, so errors are thrown from the inner functions and caught here.
  defp decode_bytes(bytes, handler, state, max) do
    {value, rest, state} = read_value(handler, bytes, state)

    if byte_size(rest) <= max,
      do: {:ok, value, state},
      else: left_over_error(byte_size(rest))
  catch
    {:not_psi, why} -> {:error, why}
  end

  defp fail_decoding(why), do: throw({:not_psi, why})

  defp read_value({:value, plan}, bytes, state),
    do: read_content(resolve_plan(plan, state), bytes, state)

  defp read_value({:object, plan}, <<prefix::little-32, rest::binary>>, state) do
    case prefix &&& @typed do
      0 when prefix == 0 -> {nil, rest, state}
      @reference -> read_reference(prefix &&& @low_bits, rest, state)
      @new when plan != nil -> read_object(resolve_plan(plan, state), nil, rest, state)
      @typed -> read_typed_object(prefix &&& @low_bits, rest, state)
      @new -> fail_decoding("an object has a type that no schema describes")
      _ -> fail_decoding("an object begins with bytes that are not a reference")
    end
  end

  defp read_value({:object, _plan}, _bytes, _state),
    do: fail_decoding("the data ends at the beginning of an object")

  defp resolve_plan({:type, name}, state), do: Map.fetch!(state.types.by_name, name)
  defp resolve_plan(plan, _state), do: plan

  defp read_typed_object(id, bytes, state) do
    case state.types.by_id do
      %{^id => plan} -> read_object(plan, state.types.names[id], bytes, state)
      _ -> fail_decoding("an object has the type number #{id}, which no schema describes")
    end
  end

  defp read_reference(id, rest, state) do
    case state.objects do
      %{^id => {value, nodes}} when nodes + state.nodes < @max_shared ->
        {value, rest, %{state | nodes: state.nodes + nodes}}

      %{^id => _open_or_large} ->
        ids = MapSet.put(state.referenced_ids, id)
        {%{"$ref" => id}, rest, %{state | referenced_ids: ids, refs: state.refs + 1}}

      _ ->
        fail_decoding("a reference points to an object that does not exist yet")
    end
  end

  defp read_object(plan, type, bytes, %{next: id, nodes: nodes, refs: refs} = state) do
    state = %{state | next: id + 1, nodes: nodes + 1, objects: Map.put(state.objects, id, :open)}
    {value, rest, state} = read_content(plan, bytes, state)
    state = forget_node_references(plan, id, refs, state)
    value = value |> with_type(type, plan) |> with_id(id, state)

    # An object that contains references by number cannot be repeated at another position.
    done = if state.refs == refs, do: {value, state.nodes - nodes}, else: :open
    {value, rest, %{state | objects: Map.put(state.objects, id, done)}}
  end

  # The nodes of a linked list refer to each other and to the list. The list's items contain none of these references.
  defp forget_node_references({:fields, _, :linked}, id, refs, state) do
    ids = state.referenced_ids |> Enum.filter(&(&1 < id)) |> MapSet.new()
    %{state | refs: refs, referenced_ids: ids}
  end

  defp forget_node_references(_plan, _id, _refs, state), do: state

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
      not MapSet.member?(state.shared_ids, id) -> value
      is_map(value) and not is_struct(value) -> Map.put(value, "$id", id)
      true -> %{"$id" => id, "$value" => value}
    end
  end

  defp read_content({:raw, layout}, bytes, state) do
    size = Layout.value_size(layout)

    case bytes do
      <<value::binary-pinned_size(size), rest::binary>> ->
        {Layout.read_value(layout, value), rest, state}

      _ ->
        fail_decoding("the data ends within a value")
    end
  end

  defp read_content(:string, bytes, state) do
    case Bytes.parse_string(bytes) do
      {:ok, text, rest} -> {text, rest, state}
      :error -> fail_decoding("the data ends within a string")
    end
  end

  defp read_content(:bytes, <<n::little-signed-32, data::binary-size(n), rest::binary>>, state)
       when n >= 0,
       do: {data, rest, state}

  defp read_content({:raw_array, layout}, <<n::little-signed-32, rest::binary>>, state)
       when n >= 0 do
    size = n * Layout.value_size(layout)

    case rest do
      <<values::binary-pinned_size(size), rest::binary>> ->
        {Layout.read_all(layout, values), rest, %{state | nodes: state.nodes + n}}

      _ ->
        fail_decoding("the data ends within an array")
    end
  end

  # Each element takes at least one byte, so a count larger than the number of bytes is invalid.
  defp read_content(:strings, <<n::little-signed-32, rest::binary>>, state)
       when n >= 0 and n <= byte_size(rest) do
    {values, {rest, state}} = repeat_read(n, {rest, state}, &read_content(:string, &1, &2))
    {values, rest, state}
  end

  defp read_content({:array, handler}, <<n::little-signed-32, rest::binary>>, state)
       when n >= 0 and n <= byte_size(rest) do
    {values, {rest, state}} = repeat_read(n, {rest, state}, &read_value(handler, &1, &2))
    {values, rest, %{state | nodes: state.nodes + n}}
  end

  defp read_content({:fields, [{"compression", handler} | members], shape}, bytes, state)
       when shape in [:image, :depth_image] do
    case read_value(handler, bytes, state) do
      {@uncompressed, rest, state} -> read_fields(members, shape, rest, state)
      {_method, rest, state} -> read_compressed(shape, members, rest, state)
    end
  end

  defp read_content({:fields, members, shape}, bytes, state),
    do: read_fields(members, shape, bytes, state)

  defp read_content(_plan, _bytes, _state),
    do: fail_decoding("the data ends within an array, or the length of an array is invalid")

  # The compressed image replaces the first five members; depth images have more members after it.
  defp read_compressed(shape, members, bytes, state) do
    kind = if shape == :image, do: "EncodedImage", else: "EncodedDepthImage"
    name = "Microsoft.Psi.Shared`1[[Microsoft.Psi.Imaging.#{kind}]]"

    case state.types.by_name do
      %{^name => plan} ->
        {image, rest, state} = read_value({:object, plan}, bytes, state)
        {_, rest, state} = read_fields(Enum.drop(members, 5), :map, rest, state)
        {image, rest, state}

      _ ->
        fail_decoding("an image is compressed in a way that no schema describes")
    end
  end

  defp read_fields(members, shape, bytes, state) do
    {values, {rest, state}} =
      Enum.map_reduce(members, {bytes, state}, fn {name, handler}, {bytes, state} ->
        {value, rest, state} = read_value(handler, bytes, state)
        {{name, value}, {rest, state}}
      end)

    {Collections.build_value(shape, values), rest, state}
  end

  defp repeat_read(n, acc, fun) do
    Enum.map_reduce(1..n//1, acc, fn _, {bytes, state} ->
      {value, rest, state} = fun.(bytes, state)
      {value, {rest, state}}
    end)
  end
end
