defmodule Situ.Bridge.Psi.Types do
  @moduledoc false
  # How each type of a store is written, worked out of its schemas once. A plan is what follows an object's prefix, or
  # the whole of a value type:
  #
  # {:raw, layout} | {:raw_array, layout} | {:array, handler} | :string | :strings | :bytes | {:fields, [{name,
  # handler}], shape}
  #
  # and a handler says how a member refers to it: {:value, plan or name} without, {:object, plan or name} with a prefix.
  alias Situ.Bridge.Psi.{Layout, Schema, TypeName}

  defstruct by_name: %{}, by_id: %{}, names: %{}, schemas: %{}

  @type plan :: term()
  @type handler :: {:value | :object, plan() | {:type, String.t()} | nil}
  @type t :: %__MODULE__{}

  @deepest 32

  @spec new([Schema.t()]) :: t()
  def new(schemas) do
    by_name =
      for schema <- schemas,
          name <- [schema.type_name, schema.name],
          into: %{},
          do: {TypeName.short(name), schema}

    types = %__MODULE__{schemas: by_name}
    plans = Map.new(by_name, fn {name, schema} -> {name, plan(types, name, schema)} end)
    by_id = Map.new(schemas, &{&1.id, plans[TypeName.short(&1.type_name)]})
    names = Map.new(schemas, &{&1.id, TypeName.short(&1.type_name)})
    %{types | by_name: plans, by_id: by_id, names: names}
  end

  @doc "How a stream or member of the type with this .NET name is written."
  @spec handler(t(), String.t()) :: handler()
  def handler(types, name), do: handle(types, TypeName.parse(name))

  defp handle(types, parsed) do
    short = TypeName.short(parsed)
    primitive = Layout.primitive(short)

    cond do
      primitive -> {:value, {:raw, primitive}}
      short == "System.String" -> {:object, :string}
      schema = types.schemas[short] -> {reference(short, schema), {:type, short}}
      true -> unlisted(types, parsed)
    end
  end

  # Types that no schema tells of: arrays, nullables and buffers explain themselves, anything else can only be an
  # object of a type that its prefix tells.
  defp unlisted(types, %{arrays: n} = parsed) when n > 0,
    do: {:object, array(types, TypeName.element(parsed))}

  defp unlisted(types, %{name: "System.Nullable`1", args: [inner]}) do
    case handle(types, inner) do
      {:value, {:raw, layout}} ->
        {:value, {:raw, Layout.struct([{"hasValue", :bool}, {"value", layout}])}}

      other ->
        {:value, {:fields, [{"hasValue", {:value, {:raw, :bool}}}, {"value", other}], :nullable}}
    end
  end

  defp unlisted(_types, %{name: name})
       when name in ["Microsoft.Psi.Common.UnmanagedBuffer", "Microsoft.Psi.Common.BufferReader"],
       do: {:object, :bytes}

  defp unlisted(_types, %{name: "Microsoft.Psi.Imaging." <> rest})
       when rest in [
              "CompressionMethod",
              "DepthCompressionMethod",
              "PixelFormat",
              "DepthValueSemantics"
            ],
       do: {:value, {:raw, :int32}}

  defp unlisted(_types, _parsed), do: {:object, nil}

  defp array(types, element) do
    case {TypeName.short(element), handle(types, element)} do
      {"System.Byte", _} -> :bytes
      {"System.String", _} -> :strings
      {_, {:value, {:raw, layout}}} -> {:raw_array, layout}
      {name, {:value, {:type, _}} = handler} -> raw_array(types, name, handler)
      {_, handler} -> {:array, handler}
    end
  end

  defp raw_array(types, name, handler) do
    case types.schemas[name] do
      %{serializer: "SimpleSerializer"} = schema -> {:raw_array, layout(types, name, schema, 0)}
      _ -> {:array, handler}
    end
  end

  # Schemas of old stores do not tell classes from structs: what is written as plain memory is a struct.
  defp reference(_short, %{serializer: "SimpleSerializer"}), do: :value

  defp reference(short, schema) do
    cond do
      Schema.struct?(schema) ->
        :value

      Schema.class?(schema) ->
        :object

      String.starts_with?(short, [
        "System.ValueTuple`",
        "System.Nullable`",
        "System.Collections.Generic.KeyValuePair`",
        "Microsoft.Psi.Message`"
      ]) ->
        :value

      true ->
        :object
    end
  end

  defp plan(types, name, schema) do
    parsed = TypeName.parse(name)

    case schema.serializer do
      "SimpleSerializer" ->
        {:raw, layout(types, name, schema, 0)}

      serializer when serializer in ["ByteArraySerializer", "BufferSerializer"] ->
        :bytes

      "MemoryStreamSerializer" <> _ ->
        if schema.version > 2, do: :bytes, else: fields(types, parsed, schema)

      "StringSerializer" ->
        :string

      "StringArraySerializer" ->
        :strings

      "SimpleArraySerializer" ->
        array(types, element(parsed, schema))

      array when array in ["ArraySerializer", "EnumerableSerializer"] ->
        array(types, element(parsed, schema))

      _ ->
        by_name(types, parsed, schema)
    end
  end

  # Before the catalog told who wrote a type.
  defp by_name(_types, %{name: "System.String", arrays: 0}, _schema), do: :string

  defp by_name(types, %{arrays: n} = parsed, _schema) when n > 0,
    do: array(types, TypeName.element(parsed))

  defp by_name(_types, %{name: "Microsoft.Psi.Common.UnmanagedBuffer"}, _schema), do: :bytes
  defp by_name(types, parsed, schema), do: fields(types, parsed, schema)

  defp element(_parsed, %{members: [{_, type}]}), do: TypeName.parse(type)
  defp element(%{arrays: n} = parsed, _schema) when n > 0, do: TypeName.element(parsed)
  defp element(%{args: [inner | _]}, _schema), do: inner
  defp element(_parsed, _schema), do: %TypeName{name: "System.Object"}

  defp fields(types, parsed, schema) do
    members = for {name, type} <- schema.members, do: {name, handler(types, type)}
    {:fields, members, shape(parsed.name, Enum.map(members, &elem(&1, 0)))}
  end

  # The values that members of well-known types make together.
  defp shape("System.Collections.Generic.List`1", ["_items", "_size" | _]), do: :list

  defp shape("System.Collections.Generic.Dictionary`2", ["Comparer", "KeyValuePairs"]),
    do: :dictionary

  defp shape("System.Collections.Generic.Dictionary`2", _), do: :old_dictionary
  defp shape("System.Nullable`1", _), do: :nullable
  defp shape("System.Tuple`" <> _, _), do: :tuple
  defp shape("System.ValueTuple`" <> _, _), do: :tuple
  defp shape("Microsoft.Psi.Shared`1", _), do: :shared
  defp shape("Microsoft.Psi.SharedContainer`1", _), do: :shared
  defp shape("Microsoft.Psi.Imaging.Image", _), do: :image
  defp shape("Microsoft.Psi.Imaging.DepthImage", _), do: :depth_image
  defp shape("Microsoft.Psi.Imaging.EncodedImage", _), do: :encoded_image
  defp shape("Microsoft.Psi.Imaging.EncodedDepthImage", _), do: :encoded_depth_image
  defp shape("Microsoft.Psi.Audio.AudioBuffer", _), do: :audio
  defp shape(_name, _members), do: :map

  defp layout(types, name, schema, depth) do
    fields =
      for {member, type} <- schema.members,
          do: {member, member_layout(types, TypeName.short(type), depth + 1)}

    Layout.primitive(name) || Layout.struct(laid_out(name, fields))
  end

  # The runtime orders the fields of these by size.
  defp laid_out("System.ValueTuple`" <> _, fields),
    do: Enum.sort_by(fields, fn {_, layout} -> -Layout.size(layout) end)

  defp laid_out(_name, fields), do: fields

  defp member_layout(types, name, depth) do
    primitive = Layout.primitive(name)
    schema = types.schemas[name]

    cond do
      primitive -> primitive
      schema && depth < @deepest -> layout(types, name, schema, depth)
      true -> nullable(types, TypeName.parse(name), depth)
    end
  end

  defp nullable(types, %{name: "System.Nullable`1", args: [inner]}, depth) when depth < @deepest,
    do:
      Layout.struct([
        {"hasValue", :bool},
        {"value", member_layout(types, TypeName.short(inner), depth + 1)}
      ])

  # An enum that no schema tells of has 32 bits as nearly all do.
  defp nullable(_types, _parsed, _depth), do: :int32

  @doc "The `Situ.Type` of what comes of it. Objects may be nil besides: .NET does not say where."
  @spec situ(t(), String.t()) :: Situ.Type.t()
  def situ(types, name), do: situ(types, TypeName.parse(name), 0)

  defp situ(_types, _parsed, depth) when depth > 8, do: :any
  defp situ(_types, %{name: "System.Byte", arrays: 1}, _), do: :binary

  defp situ(types, %{arrays: n} = parsed, depth) when n > 0,
    do: {:list, situ(types, TypeName.element(parsed), depth + 1)}

  defp situ(types, %{name: name, args: args} = parsed, depth) do
    inner = fn -> Enum.map(args, &situ(types, &1, depth + 1)) end

    case {name, args} do
      {"System.String", _} -> :string
      {"System.Object", _} -> :any
      {"System.IO.MemoryStream", _} -> :binary
      {"System.Nullable`1", [_]} -> {:optional, hd(inner.())}
      {"System.Collections.Generic.List`1", [_]} -> {:list, hd(inner.())}
      {"System.Collections.Generic.IEnumerable`1", [_]} -> {:list, hd(inner.())}
      {"System.Collections.Generic.Dictionary`2", [_, _]} -> List.to_tuple([:map | inner.()])
      {"System.Tuple`" <> _, _} -> {:tuple, inner.()}
      {"System.ValueTuple`" <> _, _} -> {:tuple, inner.()}
      {"Microsoft.Psi.Shared`1", [_]} -> hd(inner.())
      _ -> Situ.Bridge.Psi.Media.type(name) || plain(types, parsed)
    end
  end

  defp plain(types, parsed) do
    short = TypeName.short(parsed)

    case {Layout.primitive(short), types.by_name[short]} do
      {nil, {:raw, {:struct, _, _, [{"value__", 0, _}]}}} -> :integer
      {nil, nil} -> :any
      {nil, _} -> :map
      {:bool, _} -> :boolean
      {float, _} when float in [:float32, :float64] -> :float
      {text, _} when text in [:char, :decimal, :guid] -> :string
      _ -> :integer
    end
  end
end
