defmodule Situ.Bridge.Protobuf.Descriptor do
  @moduledoc false
  # Definitions in binary form: a FileDescriptorSet, decoded and encoded with its own schema. Pure.
  alias Situ.Bridge.Protobuf.{Reader, Schema, Text, Writer}
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
  @deepest 50

  defp own do
    with :none <- :persistent_term.get(__MODULE__, :none) do
      {:ok, schema} = Text.parse(@google)
      :persistent_term.put(__MODULE__, schema)
      schema
    end
  end

  @doc "Returns Google's types, for definitions that import them, as `{messages, enums}` for `Schema.new/2`."
  @spec google() :: {list(), list()}
  def google do
    {:ok, messages, enums} = Text.types(@google)
    {messages, enums}
  end

  @doc "Parses the bytes of a FileDescriptorSet to a schema."
  @spec read(binary()) :: {:ok, Schema.t()} | {:error, String.t()}
  def read(bytes) do
    with {:ok, %{"file" => files}} <- Reader.decode(own(), @set, bytes) do
      {messages, enums} = files |> Enum.map(&file/1) |> Enum.unzip()
      Schema.new(messages |> Enum.concat() |> Enum.uniq_by(&elem(&1, 0)), Enum.concat(enums))
    end
  catch
    {:not_proto, why} -> {:error, why}
  end

  defp file(file) do
    scope = file["package"] || ""
    proto3? = file["syntax"] == "proto3"
    explicit? = not proto3?
    style = %{explicit?: explicit?, packed?: file["syntax"] in ["proto3", "editions"]}
    messages = Enum.flat_map(file["message_type"], &messages(&1, scope, style, 0))
    inner = Enum.flat_map(file["message_type"], &enums(&1, scope, 0))
    {messages, Enum.map(file["enum_type"], &enum(&1, scope)) ++ inner}
  end

  defp whole("", name), do: name || ""
  defp whole(scope, name), do: scope <> "." <> (name || "")

  defp messages(_message, scope, _style, @deepest),
    do: throw({:not_proto, "#{scope} is nested #{@deepest} deep"})

  defp messages(message, scope, style, depth) do
    name = whole(scope, message["name"])
    map? = (message["options"] || %{})["map_entry"] == true
    oneofs = message["oneof_decl"] |> Enum.map(& &1["name"]) |> List.to_tuple()
    fields = Enum.flat_map(message["field"], &field(&1, name, style, oneofs))

    [
      {name, fields, map?}
      | Enum.flat_map(message["nested_type"], &messages(&1, name, style, depth + 1))
    ]
  end

  defp enums(_message, scope, @deepest),
    do: throw({:not_proto, "#{scope} is nested #{@deepest} deep"})

  defp enums(message, scope, depth) do
    name = whole(scope, message["name"])

    Enum.map(message["enum_type"], &enum(&1, name)) ++
      Enum.flat_map(message["nested_type"], &enums(&1, name, depth + 1))
  end

  defp enum(enum, scope),
    do:
      {whole(scope, enum["name"]),
       for(v <- enum["value"], do: {v["name"] || "", v["number"] || 0})}

  # The reader skips groups.
  defp field(%{"type" => 10}, _scope, _style, _oneofs), do: []

  defp field(f, scope, style, oneofs) do
    repeated? = f["label"] == 3
    type = type(f, scope)
    oneof = oneof(f, oneofs)

    [
      %Field{
        name: f["name"] || "",
        number: f["number"],
        type: type,
        repeated?: repeated?,
        packed?: repeated? and packable?(type) and packed?(f, style),
        presence?:
          not repeated? and (style.explicit? or oneof != nil or f["proto3_optional"] == true),
        oneof: oneof
      }
    ]
  end

  defp type(%{"type" => 11, "type_name" => name}, _scope) when is_binary(name),
    do: {:message, String.trim_leading(name, ".")}

  defp type(%{"type" => 14, "type_name" => name}, _scope) when is_binary(name),
    do: {:enum, String.trim_leading(name, ".")}

  defp type(%{"type" => number}, _scope) when is_map_key(@types, number), do: @types[number]

  defp type(f, scope),
    do:
      throw(
        {:not_proto,
         "the field #{inspect(f["name"])} of #{scope} has the type #{inspect(f["type"])}"}
      )

  # Proto3 represents an optional field as a oneof with one member, which is not a oneof to users.
  defp oneof(%{"oneof_index" => n, "proto3_optional" => optional}, oneofs)
       when is_integer(n) and n >= 0 and n < tuple_size(oneofs) and optional != true,
       do: elem(oneofs, n)

  defp oneof(_field, _oneofs), do: nil

  defp packable?(type), do: not match?({:message, _}, type) and type not in [:string, :bytes]

  defp packed?(%{"options" => %{"packed" => packed}}, _style) when is_boolean(packed), do: packed
  defp packed?(_field, style), do: style.packed?

  @doc "Encodes a FileDescriptorSet of the message `name` and all types it uses, with one file per package."
  @spec write(Schema.t(), String.t()) :: binary()
  def write(schema, name) do
    names = needed([name], schema, MapSet.new())
    by_package = names |> Enum.sort() |> Enum.group_by(&package(&1, schema))

    files =
      for {package, names} <- by_package do
        %{
          "name" => filed(package),
          "package" => package,
          "syntax" => "proto3",
          "dependency" => Enum.map(Enum.sort(dependencies(names, package, schema)), &filed/1),
          "message_type" => nested(names, package, schema),
          "enum_type" => own_enums(names, package, schema)
        }
      end

    {:ok, bytes} =
      Writer.encode(own(), @set, %{"file" => Enum.sort_by(files, &length(&1["dependency"]))})

    bytes
  end

  defp filed("google.protobuf"), do: "google/protobuf/timestamp.proto"
  defp filed(package), do: String.replace(package, ".", "/") <> ".proto"

  defp needed([], _schema, found), do: found

  defp needed([name | rest], schema, found) do
    if name in found do
      needed(rest, schema, found)
    else
      inner =
        case schema.messages do
          %{^name => %{fields: fields}} -> for %{type: {_, type}} <- fields, do: type
          _enum -> []
        end

      # The enclosing types of a nested type are included, too.
      above = for above <- above(name), is_map_key(schema.messages, above), do: above
      needed(inner ++ above ++ rest, schema, MapSet.put(found, name))
    end
  end

  defp above(name) do
    name |> String.split(".") |> Enum.scan(&(&2 <> "." <> &1)) |> Enum.drop(-1)
  end

  # The package is the scope of the outermost type.
  defp package(name, schema) do
    outermost =
      Enum.find(
        above(name) ++ [name],
        &(is_map_key(schema.messages, &1) or is_map_key(schema.enums, &1))
      )

    scope(outermost)
  end

  defp scope(name), do: name |> String.split(".") |> Enum.drop(-1) |> Enum.join(".")
  defp last(name), do: name |> String.split(".") |> List.last()

  defp dependencies(names, package, schema) do
    for name <- names,
        %{fields: fields} <- List.wrap(schema.messages[name]),
        %{type: {_, type}} <- fields,
        other = package(type, schema),
        other != package,
        into: MapSet.new(),
        do: other
  end

  defp nested(names, scope, schema) do
    for name <- names, is_map_key(schema.messages, name), scope(name) == scope do
      message = schema.messages[name]

      %{
        "name" => last(name),
        "field" => described_fields(message.fields),
        "oneof_decl" => for(oneof <- oneofs(message.fields), do: %{"name" => oneof}),
        "nested_type" => nested(names, name, schema),
        "enum_type" => own_enums(names, name, schema),
        "options" => if(message.map?, do: %{"map_entry" => true})
      }
    end
  end

  defp own_enums(names, scope, schema) do
    for name <- names, is_map_key(schema.enums, name), scope(name) == scope do
      values =
        for {value, n} <- Enum.sort_by(schema.enums[name].numbers, &elem(&1, 1)),
            do: %{"name" => value, "number" => n}

      # The first value of a proto3 enumeration must be zero.
      {zero, others} = Enum.split_with(values, &(&1["number"] == 0))
      %{"name" => last(name), "value" => zero ++ others}
    end
  end

  # Lists the oneofs of the definition, and then one for each field that is optional in proto3.
  defp oneofs(fields) do
    real = for %{oneof: oneof} <- fields, oneof != nil, uniq: true, do: oneof
    real ++ for(field <- fields, synthetic?(field), do: "_" <> field.name)
  end

  defp synthetic?(field),
    do: field.presence? and field.oneof == nil and not match?({:message, _}, field.type)

  defp described_fields(fields) do
    oneofs = fields |> oneofs() |> Enum.with_index() |> Map.new()

    for field <- fields do
      optional? = synthetic?(field)
      oneof = if optional?, do: "_" <> field.name, else: field.oneof

      %{
        "name" => field.name,
        "number" => field.number,
        "label" => if(field.repeated?, do: 3, else: 1),
        "type" => number(field.type),
        "type_name" => if(is_tuple(field.type), do: "." <> elem(field.type, 1)),
        "oneof_index" => oneofs[oneof],
        "proto3_optional" => if(optional?, do: true),
        "options" => packing(field)
      }
    end
  end

  defp number({:message, _}), do: 11
  defp number({:enum, _}), do: 14
  defp number(type), do: @numbers[type]

  defp packing(%{repeated?: true, packed?: false, type: type}) do
    if packable?(type), do: %{"packed" => false}
  end

  defp packing(_field), do: nil
end
