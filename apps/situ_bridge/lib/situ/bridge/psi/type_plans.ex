defmodule Situ.Bridge.Psi.TypePlans do
  @moduledoc false
  # Derives from the schemas of a store how each type is serialized. A plan describes the bytes after an object's
  # prefix, or all bytes of a value type:
  #
  # {:raw, layout} | {:raw_array, layout} | {:array, handler} | :string | :strings | :bytes | {:fields, [{name,
  # handler}], shape}
  #
  # A handler describes how a member contains its type: {:value, plan or name} without a prefix, {:object, plan or name}
  # with a prefix.
  alias Situ.Bridge.Psi.{Layout, Schema, Collections, ValueTypes, TypeName}

  defstruct by_name: %{}, by_id: %{}, names: %{}, schemas: %{}, enum: :int32, others: []

  @type plan :: term()
  @type handler :: {:value | :object, plan() | {:type, String.t()} | nil}
  @type t :: %__MODULE__{}

  @max_depth 32

  @doc """
  Builds the plans of all types. `runtime` maps type numbers to the type names that streams declare, because the first
  version of \\psi stored no schemas. Enums without a schema are assumed to have 32 bits. `others` has the plans for
  other enum widths, if they differ.
  """
  @spec new([Schema.t()], %{integer() => String.t()}) :: t()
  def new(schemas, runtime \\ %{}) do
    by_name =
      for schema <- schemas,
          name <- [schema.type_name, schema.name],
          into: %{},
          do: {TypeName.short_name(name), schema}

    runtime_names =
      for {id, name} <- runtime, is_binary(name), into: %{}, do: {id, TypeName.short_name(name)}

    names =
      Map.merge(runtime_names, Map.new(schemas, &{&1.id, TypeName.short_name(&1.type_name)}))

    types = put_plans(%__MODULE__{schemas: by_name, names: names})

    others =
      for enum <- [:uint8, :int16, :int64],
          other = put_plans(%{types | enum: enum}),
          other.by_name != types.by_name,
          do: other

    %{types | others: others}
  end

  defp put_plans(types) do
    plans =
      Map.new(types.schemas, fn {name, schema} -> {name, build_plan(types, name, schema)} end)

    by_id =
      Map.new(types.names, fn {id, name} -> {id, plans[name] || elem(handler(types, name), 1)} end)

    %{types | by_name: plans, by_id: by_id}
  end

  @doc "Returns the handler of a stream or member with this .NET type name."
  @spec handler(t(), String.t()) :: handler()
  def handler(types, name), do: build_handler(types, TypeName.parse(name))

  defp build_handler(types, parsed) do
    short = TypeName.short_name(parsed)
    primitive = Layout.find_primitive(short)

    cond do
      primitive -> {:value, {:raw, primitive}}
      short == "System.String" -> {:object, :string}
      schema = types.schemas[short] -> {reference_kind(short, schema), {:type, short}}
      true -> unlisted_handler(types, parsed)
    end
  end

  # Handles types without a schema. Arrays, nullables and buffers need none. Any other type can only be an object, and
  # its prefix identifies the type.
  defp unlisted_handler(types, %{arrays: n} = parsed) when n > 0,
    do: {:object, array_plan(types, TypeName.element_type(parsed))}

  # Only .NET primitives are copied together with their `hasValue` flag as one block of memory.
  defp unlisted_handler(types, %{name: "System.Nullable`1", args: [inner]}) do
    if blittable?(types, TypeName.short_name(inner)) do
      {:value, {:raw, nullable_layout(types, inner)}}
    else
      members = [{"hasValue", {:value, {:raw, :bool}}}, {"value", build_handler(types, inner)}]
      {:value, {:fields, members, :nullable}}
    end
  end

  defp unlisted_handler(_types, %{name: name})
       when name in ["Microsoft.Psi.Common.UnmanagedBuffer", "Microsoft.Psi.Common.BufferReader"],
       do: {:object, :bytes}

  defp unlisted_handler(_types, %{name: name}),
    do: if(name in ValueTypes.enum_names(), do: {:value, {:raw, :int32}}, else: {:object, nil})

  defp array_plan(types, element) do
    case {TypeName.short_name(element), build_handler(types, element)} do
      {"System.Byte", _} -> :bytes
      {"System.String", _} -> :strings
      {_, {:value, {:raw, layout}}} -> {:raw_array, layout}
      {name, {:value, {:type, _}} = handler} -> raw_array_plan(types, name, handler)
      {_, handler} -> {:array, handler}
    end
  end

  defp raw_array_plan(types, name, handler) do
    case types.schemas[name] do
      %{serializer: "SimpleSerializer"} = schema ->
        {:raw_array, build_layout(types, name, schema, 0)}

      _ ->
        {:array, handler}
    end
  end

  # Schemas of old stores do not distinguish classes from structs. A type that is written as plain memory is a struct.
  defp reference_kind(_short, %{serializer: "SimpleSerializer"}), do: :value

  defp reference_kind(short, schema) do
    cond do
      Schema.struct?(schema) -> :value
      Schema.class?(schema) -> :object
      Schema.enum?(schema) or ValueTypes.struct_name?(short) -> :value
      true -> :object
    end
  end

  defp build_plan(types, name, schema) do
    parsed = TypeName.parse(name)

    case schema.serializer do
      "SimpleSerializer" ->
        {:raw, build_layout(types, name, schema, 0)}

      serializer when serializer in ["ByteArraySerializer", "BufferSerializer"] ->
        :bytes

      "MemoryStreamSerializer" <> _ ->
        if schema.version > 2, do: :bytes, else: fields_plan(types, parsed, schema)

      "StringSerializer" ->
        :string

      "StringArraySerializer" ->
        :strings

      "SimpleArraySerializer" ->
        array_plan(types, element_type(parsed, schema))

      array when array in ["ArraySerializer", "EnumerableSerializer"] ->
        array_plan(types, element_type(parsed, schema))

      "" ->
        unsigned_plan(types, name, parsed, schema)

      _ ->
        plan_by_name(types, parsed, schema)
    end
  end

  # Without a serializer in the schema, a struct that contains only primitives is copied as memory.
  defp unsigned_plan(types, name, parsed, schema) do
    if reference_kind(name, schema) == :value and schema.members != [] and
         Enum.all?(schema.members, fn {_, type} ->
           blittable?(types, TypeName.short_name(type))
         end),
       do: {:raw, build_layout(types, name, schema, 0)},
       else: plan_by_name(types, parsed, schema)
  end

  defp blittable?(types, name) do
    cond do
      Layout.clr_primitive?(name) -> true
      Layout.find_primitive(name) -> false
      schema = types.schemas[name] -> Schema.enum?(schema)
      true -> name in ValueTypes.enum_names()
    end
  end

  # Handles catalogs from before serializers were recorded.
  defp plan_by_name(_types, %{name: "System.String", arrays: 0}, _schema), do: :string

  defp plan_by_name(types, %{arrays: n} = parsed, _schema) when n > 0,
    do: array_plan(types, TypeName.element_type(parsed))

  defp plan_by_name(_types, %{name: "Microsoft.Psi.Common.UnmanagedBuffer"}, _schema), do: :bytes
  defp plan_by_name(types, parsed, schema), do: fields_plan(types, parsed, schema)

  defp element_type(_parsed, %{members: [{_, type}]}), do: TypeName.parse(type)
  defp element_type(%{arrays: n} = parsed, _schema) when n > 0, do: TypeName.element_type(parsed)
  defp element_type(%{args: [inner | _]}, _schema), do: inner
  defp element_type(_parsed, _schema), do: %TypeName{name: "System.Object"}

  defp fields_plan(types, parsed, schema) do
    shape = Collections.shape_of(parsed.name, Enum.map(schema.members, &elem(&1, 0)))

    {:fields,
     for({name, type} <- schema.members, do: {name, member_handler(types, shape, name, type)}),
     shape}
  end

  # The schema of depth images declares the scale as a number, but both of these members are nullable.
  defp member_handler(_types, :depth_image, "depthValueSemantics", _type),
    do: {:value, {:raw, Layout.struct_layout([{"hasValue", :bool}, {"value", :int32}])}}

  defp member_handler(_types, :depth_image, "depthValueToMetersScaleFactor", _type),
    do: {:value, {:raw, Layout.struct_layout([{"hasValue", :bool}, {"value", :float64}])}}

  defp member_handler(types, _shape, _name, type), do: handler(types, type)

  defp build_layout(types, name, schema, depth) do
    fields =
      for {member, type} <- schema.members,
          do: {member, member_layout(types, TypeName.short_name(type), depth + 1)}

    Layout.find_primitive(name) || choose_layout(name, fields)
  end

  defp choose_layout("System.ValueTuple`" <> _, [_ | _] = fields), do: Layout.tuple_layout(fields)
  defp choose_layout(_name, fields), do: Layout.struct_layout(fields)

  defp member_layout(types, name, depth) do
    primitive = Layout.find_primitive(name)
    schema = types.schemas[name]

    cond do
      primitive -> primitive
      schema && depth < @max_depth -> build_layout(types, name, schema, depth)
      true -> unlisted_layout(types, TypeName.parse(name), depth)
    end
  end

  defp unlisted_layout(types, %{name: "System.Nullable`1", args: [inner]}, depth)
       when depth < @max_depth,
       do: nullable_layout(types, inner, depth + 1)

  defp unlisted_layout(_types, %{name: "Microsoft.Psi." <> _}, _depth), do: :int32
  # Any other type without a schema must be an enum.
  defp unlisted_layout(types, _parsed, _depth), do: types.enum

  defp nullable_layout(types, inner, depth \\ 0) do
    value = member_layout(types, TypeName.short_name(inner), depth)
    Layout.struct_layout([{"hasValue", :bool}, {"value", value}])
  end

  @doc "Returns the `Situ.Type` of decoded values. Any object may also be nil; .NET does not declare nullability."
  @spec situ_type(t(), String.t()) :: Situ.Type.t()
  def situ_type(types, name), do: convert_type(types, TypeName.parse(name), 0)

  defp convert_type(_types, _parsed, depth) when depth > 8, do: :any
  defp convert_type(_types, %{name: "System.Byte", arrays: 1}, _), do: :binary

  defp convert_type(types, %{arrays: n} = parsed, depth) when n > 0,
    do: {:list, convert_type(types, TypeName.element_type(parsed), depth + 1)}

  defp convert_type(types, %{name: name, args: args} = parsed, depth) do
    inner = fn -> Enum.map(args, &convert_type(types, &1, depth + 1)) end

    case {name, args} do
      {"System.String", _} ->
        :string

      {"System.Object", _} ->
        :any

      {"System.IO.MemoryStream", _} ->
        :binary

      {"System.Nullable`1", [_]} ->
        {:optional, hd(inner.())}

      {"System.Collections." <> _ = name, [_]} ->
        if Collections.list?(name), do: {:list, hd(inner.())}, else: plain_type(types, parsed)

      {"System.Collections." <> _ = name, [_, _]} ->
        if Collections.map?(name),
          do: List.to_tuple([:map | inner.()]),
          else: plain_type(types, parsed)

      {"System.Tuple`" <> _, _} ->
        {:tuple, inner.()}

      {"System.ValueTuple`" <> _, _} ->
        {:tuple, inner.()}

      {"Microsoft.Psi.Shared`1", [_]} ->
        hd(inner.())

      _ ->
        Situ.Bridge.Psi.Media.situ_type(name) || plain_type(types, parsed)
    end
  end

  defp plain_type(types, parsed) do
    short = TypeName.short_name(parsed)

    case {Layout.find_primitive(short), types.by_name[short]} do
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
