defmodule Situ.Bridge.Protobuf.ProtoParser do
  @moduledoc false
  # Parses `.proto` files of proto2 and proto3: messages, enumerations, maps and oneofs. Options, services and imports
  # are skipped; imported definitions must be part of the same text. Pure.
  alias Situ.Bridge.Protobuf.Schema
  alias Schema.Field

  @comments ~S(//[^\n]*|/\*.*?\*/)
  @strings ~S{"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'}
  @words ~S(\.?[A-Za-z_][\w.]*|-?0[xX][\da-fA-F]+|-?[\d.][\w.+-]*|\S)
  @token Regex.compile!(Enum.join([@comments, @strings, @words], "|"), "s")
  @max_depth 50

  @doc "Parses a text to a schema; `known_types` lists the messages and enumerations that the text may refer to."
  @spec parse(String.t(), [{list(), list()}]) :: {:ok, Schema.t()} | {:error, String.t()}
  def parse(text, known_types \\ []) do
    with {:ok, messages, enums} <- parse_types(text) do
      {more_messages, more_enums} = Enum.unzip(known_types)
      Schema.new(messages ++ Enum.concat(more_messages), enums ++ Enum.concat(more_enums))
    end
  end

  @doc "Returns the types of a text with their full names: `{:ok, messages, enums}` for `Schema.new/2`."
  @spec parse_types(String.t()) :: {:ok, list(), list()} | {:error, String.t()}
  def parse_types(text) do
    if String.valid?(text) do
      tokens = @token |> Regex.scan(text) |> Enum.map(&hd/1) |> Enum.reject(&comment?/1)
      file = parse_file(tokens, %{package: "", proto3?: false, messages: [], enums: []})
      {:ok, resolve_types(file), Enum.reverse(file.enums)}
    else
      {:error, "the definition is not valid UTF-8"}
    end
  catch
    {:not_proto, why} -> {:error, why}
  end

  defp comment?("//" <> _), do: true
  defp comment?("/*" <> _), do: true
  defp comment?(_), do: false

  defp fail_parsing(what), do: throw({:not_proto, what})

  @spec fail_at_tokens([String.t()]) :: no_return()
  defp fail_at_tokens(tokens),
    do: throw({:not_proto, "unexpected text: #{inspect(Enum.join(Enum.take(tokens, 5), " "))}"})

  defp parse_file([], file), do: file

  defp parse_file(["syntax", "=", syntax, ";" | rest], file),
    do: parse_file(rest, %{file | proto3?: unquote_string(syntax) == "proto3"})

  defp parse_file(["package", name, ";" | rest], file),
    do: parse_file(rest, %{file | package: name})

  defp parse_file([";" | rest], file), do: parse_file(rest, file)

  defp parse_file([word | rest], file) when word in ["import", "option"],
    do: parse_file(skip_statement(rest), file)

  defp parse_file([word | rest], file) when word in ["service", "extend"],
    do: parse_file(skip_block(rest), file)

  defp parse_file(["message", name, "{" | rest], file) do
    {rest, file} = parse_message(rest, full_name(file.package, name), file, 0)
    parse_file(rest, file)
  end

  defp parse_file(["enum", name, "{" | rest], file) do
    {rest, file} = parse_enum(rest, full_name(file.package, name), file)
    parse_file(rest, file)
  end

  defp parse_file(tokens, _file), do: fail_at_tokens(tokens)

  defp unquote_string(text), do: String.slice(text, 1..-2//1)
  defp full_name("", name), do: name
  defp full_name(scope, name), do: scope <> "." <> name

  # Skips to the position after the next semicolon, and over any nested block in braces.
  defp skip_statement([";" | rest]), do: rest
  defp skip_statement(["{" | rest]), do: rest |> skip_block_body(1) |> skip_statement()
  defp skip_statement([_ | rest]), do: skip_statement(rest)
  defp skip_statement([]), do: fail_parsing("a statement does not end")

  defp skip_block(["{" | rest]), do: skip_block_body(rest, 1)
  defp skip_block([_ | rest]), do: skip_block(rest)
  defp skip_block([]), do: fail_parsing("a block does not begin")

  defp skip_block_body(rest, 0), do: rest
  defp skip_block_body(["{" | rest], depth), do: skip_block_body(rest, depth + 1)
  defp skip_block_body(["}" | rest], depth), do: skip_block_body(rest, depth - 1)
  defp skip_block_body([_ | rest], depth), do: skip_block_body(rest, depth)
  defp skip_block_body([], _depth), do: fail_parsing("a block does not end")

  defp parse_message(_tokens, name, _file, depth) when depth > @max_depth,
    do: fail_parsing("#{name} is nested deeper than #{@max_depth} messages")

  defp parse_message(tokens, name, file, depth) do
    {rest, file, fields} = parse_body(tokens, name, file, [], nil, depth)
    {rest, %{file | messages: [{name, Enum.reverse(fields), false} | file.messages]}}
  end

  defp parse_body(["}" | rest], _name, file, fields, _oneof, _depth), do: {rest, file, fields}

  defp parse_body([";" | rest], name, file, fields, oneof, depth),
    do: parse_body(rest, name, file, fields, oneof, depth)

  defp parse_body(["message", inner, "{" | rest], name, file, fields, nil, depth) do
    {rest, file} = parse_message(rest, full_name(name, inner), file, depth + 1)
    parse_body(rest, name, file, fields, nil, depth)
  end

  defp parse_body(["enum", inner, "{" | rest], name, file, fields, nil, depth) do
    {rest, file} = parse_enum(rest, full_name(name, inner), file)
    parse_body(rest, name, file, fields, nil, depth)
  end

  defp parse_body(["oneof", oneof, "{" | rest], name, file, fields, nil, depth) do
    {rest, file, fields} = parse_body(rest, name, file, fields, oneof, depth)
    parse_body(rest, name, file, fields, nil, depth)
  end

  defp parse_body(
         ["map", "<", key, ",", type, ">", field | rest],
         name,
         file,
         fields,
         nil,
         depth
       ) do
    entry = full_name(name, Macro.camelize(field) <> "Entry")
    value = %Field{name: "value", number: 2, type: {:unresolved, type, name}}
    key = %Field{name: "key", number: 1, type: {:unresolved, key, name}}
    {number, _options, rest} = parse_field_end(rest)
    field = %Field{name: field, number: number, type: {:message, entry}, repeated?: true}
    file = %{file | messages: [{entry, [key, value], true} | file.messages]}
    parse_body(rest, name, file, [field | fields], nil, depth)
  end

  defp parse_body([word | rest], name, file, fields, oneof, depth)
       when word in ["option", "reserved", "extensions"],
       do: parse_body(skip_statement(rest), name, file, fields, oneof, depth)

  defp parse_body(["extend" | rest], name, file, fields, oneof, depth),
    do: parse_body(skip_block(rest), name, file, fields, oneof, depth)

  defp parse_body([label, type, field, "=" | _] = tokens, name, file, fields, oneof, depth)
       when label in ["optional", "required", "repeated"] and type != "group" do
    {number, options, rest} = tokens |> Enum.drop(3) |> parse_field_end()
    field = build_field(type, field, number, name, label, options, oneof, file.proto3?)
    parse_body(rest, name, file, [field | fields], oneof, depth)
  end

  defp parse_body([type, field, "=" | _] = tokens, name, file, fields, oneof, depth) do
    {number, options, rest} = tokens |> Enum.drop(2) |> parse_field_end()
    field = build_field(type, field, number, name, nil, options, oneof, file.proto3?)
    parse_body(rest, name, file, [field | fields], oneof, depth)
  end

  defp parse_body([], name, _file, _fields, _oneof, _depth),
    do: fail_parsing("#{name} does not end")

  defp parse_body(tokens, _name, _file, _fields, _oneof, _depth), do: fail_at_tokens(tokens)

  defp build_field(type, name, number, scope, label, options, oneof, proto3?) do
    repeated? = label == "repeated"

    %Field{
      name: name,
      number: number,
      type: {:unresolved, type, scope},
      repeated?: repeated?,
      packed?: repeated? and Keyword.get(options, :packed, proto3?),
      presence?: not repeated? and (oneof != nil or label != nil or not proto3?),
      oneof: oneof
    }
  end

  defp parse_field_end(["=", number, ";" | rest]), do: {parse_integer(number), [], rest}

  defp parse_field_end(["=", number, "[" | rest]) do
    {options, after_options} = Enum.split_while(rest, &(&1 != ";"))
    packed = Enum.chunk_every(options, 3, 1)

    options =
      cond do
        ["packed", "=", "true"] in packed -> [packed: true]
        ["packed", "=", "false"] in packed -> [packed: false]
        true -> []
      end

    case after_options do
      [";" | rest] -> {parse_integer(number), options, rest}
      [] -> fail_parsing("a field does not end")
    end
  end

  defp parse_field_end(tokens), do: fail_at_tokens(tokens)

  defp parse_integer(text) do
    case Integer.parse(text) do
      {0, "x" <> digits} -> parse_hexadecimal(digits)
      {n, ""} -> n
      _ -> fail_parsing("#{inspect(text)} is not a number")
    end
  end

  defp parse_hexadecimal(digits) do
    case Integer.parse(digits, 16) do
      {n, ""} -> n
      _ -> fail_parsing("0x#{digits} is not a number")
    end
  end

  defp parse_enum(tokens, name, file) do
    {rest, values} = parse_enum_values(tokens, name, [])
    {rest, %{file | enums: [{name, Enum.reverse(values)} | file.enums]}}
  end

  defp parse_enum_values(["}" | rest], _name, values), do: {rest, values}
  defp parse_enum_values([";" | rest], name, values), do: parse_enum_values(rest, name, values)

  defp parse_enum_values([word | rest], name, values) when word in ["option", "reserved"],
    do: parse_enum_values(skip_statement(rest), name, values)

  defp parse_enum_values([value, "=" | _] = tokens, name, values) do
    {number, _options, rest} = tokens |> Enum.drop(1) |> parse_field_end()
    parse_enum_values(rest, name, [{value, number} | values])
  end

  defp parse_enum_values([], name, _values), do: fail_parsing("#{name} does not end")
  defp parse_enum_values(tokens, _name, _values), do: fail_at_tokens(tokens)

  # A type name is resolved from the innermost scope outwards.
  defp resolve_types(file) do
    messages = MapSet.new(file.messages, &elem(&1, 0))
    enums = MapSet.new(file.enums, &elem(&1, 0))

    for {name, fields, map?} <- Enum.reverse(file.messages) do
      {name, Enum.map(fields, &resolve_field(&1, messages, enums)), map?}
    end
  end

  defp resolve_field(%{type: {:unresolved, name, scope}} = field, messages, enums) do
    case Schema.fetch_scalar(name) do
      {:ok, type} -> clear_unpackable(%{field | type: type})
      :error -> put_named_type(field, find_type(name, scope, messages, enums))
    end
  end

  defp resolve_field(field, _messages, _enums), do: field

  defp clear_unpackable(%{type: type} = field) when type in [:string, :bytes],
    do: %{field | packed?: false}

  defp clear_unpackable(field), do: field

  defp put_named_type(field, {:enum, _} = type), do: %{field | type: type}
  defp put_named_type(field, type), do: %{field | type: type, packed?: false}

  # A fully qualified name of an unknown type is kept, because `known_types` may define it.
  defp find_type("." <> name, _scope, _messages, enums),
    do: if(name in enums, do: {:enum, name}, else: {:message, name})

  defp find_type(name, scope, messages, enums) do
    names = name |> candidate_names(scope) |> Enum.reverse()

    cond do
      match = Enum.find(names, &(&1 in messages)) -> {:message, match}
      match = Enum.find(names, &(&1 in enums)) -> {:enum, match}
      true -> {:message, name}
    end
  end

  defp candidate_names(name, scope) do
    scope
    |> String.split(".", trim: true)
    |> Enum.scan(&(&2 <> "." <> &1))
    |> Enum.map(&(&1 <> "." <> name))
    |> then(&[name | &1])
  end
end
