defmodule Situ.Bridge.Protobuf.Descriptor do
  @moduledoc false
  # Decodes and encodes definitions in binary form (a FileDescriptorSet) with their own schema. Pure.
  alias Situ.Bridge.Protobuf.{Reader, Schema, ProtoParser, Writer}
  alias Schema.Field

  @external_resource path = Path.expand("../../../../priv/protobuf/google.proto", __DIR__)
  @google File.read!(path)
  @set "google.protobuf.FileDescriptorSet"

  # Types by their numbers in FieldDescriptorProto. Groups (10) are not supported.
  @types %{
    1 => :double,
    2 => :float,
    3 => :int64,
    4 => :uint64,
    5 => :int32,
    6 => :fixed64,
    7 => :fixed32,
    8 => :bool,
    9 => :string,
    12 => :bytes,
    13 => :uint32,
    15 => :sfixed32,
    16 => :sfixed64,
    17 => :sint32,
    18 => :sint64
  }
  @numbers Map.new(@types, fn {number, type} -> {type, number} end)
  @max_depth 50

  defp descriptor_schema do
    with :none <- :persistent_term.get(__MODULE__, :none) do
      {:ok, schema} = ProtoParser.parse(@google)
      :persistent_term.put(__MODULE__, schema)
      schema
    end
  end

  @doc "Returns Google's types, for definitions that import them, as `{messages, enums}` for `Schema.new/2`."
  @spec google_types() :: {list(), list()}
  def google_types do
    {:ok, messages, enums} = ProtoParser.parse_types(@google)
    {messages, enums}
  end

  @doc "Parses the bytes of a FileDescriptorSet to a schema."
  @spec parse_set(binary()) :: {:ok, Schema.t()} | {:error, String.t()}
  def parse_set(bytes) do
    with {:ok, %{"file" => files}} <- Reader.decode(descriptor_schema(), @set, bytes) do
      {messages, enums} = files |> Enum.map(&parse_file/1) |> Enum.unzip()
      Schema.new(messages |> Enum.concat() |> Enum.uniq_by(&elem(&1, 0)), Enum.concat(enums))
    end
  catch
    {:not_proto, why} -> {:error, why}
  end

  defp parse_file(file) do
    scope = file["package"] || ""
    proto3? = file["syntax"] == "proto3"
    explicit? = not proto3?
    style = %{explicit?: explicit?, packed?: file["syntax"] in ["proto3", "editions"]}
    messages = Enum.flat_map(file["message_type"], &parse_messages(&1, scope, style, 0))
    inner = Enum.flat_map(file["message_type"], &parse_enums(&1, scope, 0))
    {messages, Enum.map(file["enum_type"], &parse_enum(&1, scope)) ++ inner}
  end

  defp full_name("", name), do: name || ""
  defp full_name(scope, name), do: scope <> "." <> (name || "")

  defp parse_messages(_message, scope, _style, @max_depth),
    do: throw({:not_proto, "#{scope} is nested #{@max_depth} deep"})

  defp parse_messages(message, scope, style, depth) do
    name = full_name(scope, message["name"])
    map? = (message["options"] || %{})["map_entry"] == true
    oneofs = message["oneof_decl"] |> Enum.map(& &1["name"]) |> List.to_tuple()
    fields = Enum.flat_map(message["field"], &parse_field(&1, name, style, oneofs))

    [
      {name, fields, map?}
      | Enum.flat_map(message["nested_type"], &parse_messages(&1, name, style, depth + 1))
    ]
  end

  defp parse_enums(_message, scope, @max_depth),
    do: throw({:not_proto, "#{scope} is nested #{@max_depth} deep"})

  defp parse_enums(message, scope, depth) do
    name = full_name(scope, message["name"])

    Enum.map(message["enum_type"], &parse_enum(&1, name)) ++
      Enum.flat_map(message["nested_type"], &parse_enums(&1, name, depth + 1))
  end

  defp parse_enum(enum, scope),
    do:
      {full_name(scope, enum["name"]),
       for(v <- enum["value"], do: {v["name"] || "", v["number"] || 0})}

  # The reader skips groups.
  defp parse_field(%{"type" => 10}, _scope, _style, _oneofs), do: []

  defp parse_field(field, scope, style, oneofs) do
    repeated? = field["label"] == 3
    type = parse_type(field, scope)
    oneof = oneof_name(field, oneofs)

    [
      %Field{
        name: field["name"] || "",
        number: field["number"],
        type: type,
        repeated?: repeated?,
        packed?: repeated? and packable?(type) and packed?(field, style),
        presence?:
          not repeated? and (style.explicit? or oneof != nil or field["proto3_optional"] == true),
        oneof: oneof
      }
    ]
  end

  defp parse_type(%{"type" => 11, "type_name" => name}, _scope) when is_binary(name),
    do: {:message, String.trim_leading(name, ".")}

  defp parse_type(%{"type" => 14, "type_name" => name}, _scope) when is_binary(name),
    do: {:enum, String.trim_leading(name, ".")}

  defp parse_type(%{"type" => number}, _scope) when is_map_key(@types, number), do: @types[number]

  defp parse_type(field, scope),
    do:
      throw(
        {:not_proto,
         "the field #{inspect(field["name"])} of #{scope} has the type #{inspect(field["type"])}"}
      )

  # Proto3 represents an optional field as a oneof with one member, which is not a oneof to users.
  defp oneof_name(%{"oneof_index" => n, "proto3_optional" => optional}, oneofs)
       when is_integer(n) and n >= 0 and n < tuple_size(oneofs) and optional != true,
       do: elem(oneofs, n)

  defp oneof_name(_field, _oneofs), do: nil

  defp packable?(type), do: not match?({:message, _}, type) and type not in [:string, :bytes]

  defp packed?(%{"options" => %{"packed" => packed}}, _style) when is_boolean(packed), do: packed
  defp packed?(_field, style), do: style.packed?

  @doc "Encodes a FileDescriptorSet of the message `name` and all types it uses, with one file per package."
  @spec encode_set(Schema.t(), String.t()) :: binary()
  def encode_set(schema, name) do
    names = collect_types([name], schema, MapSet.new())
    by_package = names |> Enum.sort() |> Enum.group_by(&package_of(&1, schema))

    files =
      for {package, names} <- by_package do
        %{
          "name" => file_name(package),
          "package" => package,
          "syntax" => "proto3",
          "dependency" =>
            Enum.map(Enum.sort(package_dependencies(names, package, schema)), &file_name/1),
          "message_type" => describe_messages(names, package, schema),
          "enum_type" => describe_enums(names, package, schema)
        }
      end

    {:ok, bytes} =
      Writer.encode(descriptor_schema(), @set, %{
        "file" => Enum.sort_by(files, &length(&1["dependency"]))
      })

    bytes
  end

  defp file_name("google.protobuf"), do: "google/protobuf/timestamp.proto"
  defp file_name(package), do: String.replace(package, ".", "/") <> ".proto"

  defp collect_types([], _schema, types), do: types

  defp collect_types([name | rest], schema, types) do
    if name in types do
      collect_types(rest, schema, types)
    else
      inner =
        case schema.messages do
          %{^name => %{fields: fields}} -> for %{type: {_, type}} <- fields, do: type
          _enum -> []
        end

      # The enclosing types of a nested type are included, too.
      outer = for outer <- outer_names(name), is_map_key(schema.messages, outer), do: outer
      collect_types(inner ++ outer ++ rest, schema, MapSet.put(types, name))
    end
  end

  defp outer_names(name) do
    name |> String.split(".") |> Enum.scan(&(&2 <> "." <> &1)) |> Enum.drop(-1)
  end

  # The package is the scope of the outermost type.
  defp package_of(name, schema) do
    outermost =
      Enum.find(
        outer_names(name) ++ [name],
        &(is_map_key(schema.messages, &1) or is_map_key(schema.enums, &1))
      )

    parent_scope(outermost)
  end

  defp parent_scope(name), do: name |> String.split(".") |> Enum.drop(-1) |> Enum.join(".")
  defp short_name(name), do: name |> String.split(".") |> List.last()

  defp package_dependencies(names, package, schema) do
    for name <- names,
        %{fields: fields} <- List.wrap(schema.messages[name]),
        %{type: {_, type}} <- fields,
        other = package_of(type, schema),
        other != package,
        into: MapSet.new(),
        do: other
  end

  defp describe_messages(names, scope, schema) do
    for name <- names, is_map_key(schema.messages, name), parent_scope(name) == scope do
      message = schema.messages[name]

      %{
        "name" => short_name(name),
        "field" => describe_fields(message.fields),
        "oneof_decl" => for(oneof <- oneof_names(message.fields), do: %{"name" => oneof}),
        "nested_type" => describe_messages(names, name, schema),
        "enum_type" => describe_enums(names, name, schema),
        "options" => if(message.map?, do: %{"map_entry" => true})
      }
    end
  end

  defp describe_enums(names, scope, schema) do
    for name <- names, is_map_key(schema.enums, name), parent_scope(name) == scope do
      values =
        for {value, n} <- Enum.sort_by(schema.enums[name].numbers, &elem(&1, 1)),
            do: %{"name" => value, "number" => n}

      # The first value of a proto3 enumeration must be zero.
      {zero, others} = Enum.split_with(values, &(&1["number"] == 0))
      %{"name" => short_name(name), "value" => zero ++ others}
    end
  end

  # Lists the oneofs of the definition, and then one for each field that is optional in proto3.
  defp oneof_names(fields) do
    declared = for %{oneof: oneof} <- fields, oneof != nil, uniq: true, do: oneof
    declared ++ for(field <- fields, synthetic_oneof?(field), do: "_" <> field.name)
  end

  defp synthetic_oneof?(field),
    do: field.presence? and field.oneof == nil and not match?({:message, _}, field.type)

  defp describe_fields(fields) do
    oneofs = fields |> oneof_names() |> Enum.with_index() |> Map.new()

    for field <- fields do
      optional? = synthetic_oneof?(field)
      oneof = if optional?, do: "_" <> field.name, else: field.oneof

      %{
        "name" => field.name,
        "number" => field.number,
        "label" => if(field.repeated?, do: 3, else: 1),
        "type" => type_number(field.type),
        "type_name" => if(is_tuple(field.type), do: "." <> elem(field.type, 1)),
        "oneof_index" => oneofs[oneof],
        "proto3_optional" => if(optional?, do: true),
        "options" => packing_options(field)
      }
    end
  end

  defp type_number({:message, _}), do: 11
  defp type_number({:enum, _}), do: 14
  defp type_number(type), do: @numbers[type]

  defp packing_options(%{repeated?: true, packed?: false, type: type}) do
    if packable?(type), do: %{"packed" => false}
  end

  defp packing_options(_field), do: nil
end
