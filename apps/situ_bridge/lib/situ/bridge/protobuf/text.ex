defmodule Situ.Bridge.Protobuf.Text do
  @moduledoc false
  # Parses `.proto` files of proto2 and proto3: messages, enumerations, maps and oneofs. Options, services and imports
  # are skipped; imported definitions must be part of the same text. Pure.
  alias Situ.Bridge.Protobuf.Schema
  alias Schema.Field

  @comments ~S(//[^\n]*|/\*.*?\*/)
  @strings ~S{"(?:[^"\\\n]|\\.)*"|'(?:[^'\\\n]|\\.)*'}
  @words ~S(\.?[A-Za-z_][\w.]*|-?0[xX][\da-fA-F]+|-?[\d.][\w.+-]*|\S)
  @token Regex.compile!(Enum.join([@comments, @strings, @words], "|"), "s")
  @deepest 50

  @doc "Parses a text to a schema; `also` lists the messages and enumerations that the text may refer to."
  @spec parse(String.t(), [{list(), list()}]) :: {:ok, Schema.t()} | {:error, String.t()}
  def parse(text, also \\ []) do
    with {:ok, messages, enums} <- types(text) do
      {more_messages, more_enums} = Enum.unzip(also)
      Schema.new(messages ++ Enum.concat(more_messages), enums ++ Enum.concat(more_enums))
    end
  end

  @doc "Returns the types of a text with their full names: `{:ok, messages, enums}` for `Schema.new/2`."
  @spec types(String.t()) :: {:ok, list(), list()} | {:error, String.t()}
  def types(text) do
    if String.valid?(text) do
      tokens = @token |> Regex.scan(text) |> Enum.map(&hd/1) |> Enum.reject(&comment?/1)
      found = file(tokens, %{package: "", proto3?: false, messages: [], enums: []})
      {:ok, resolved(found), Enum.reverse(found.enums)}
    else
      {:error, "the definition is not valid UTF-8"}
    end
  catch
    {:not_proto, why} -> {:error, why}
  end

  defp comment?("//" <> _), do: true
  defp comment?("/*" <> _), do: true
  defp comment?(_), do: false

  defp fail(what), do: throw({:not_proto, what})

  @spec odd([String.t()]) :: no_return()
  defp odd(tokens),
    do: throw({:not_proto, "unexpected text: #{inspect(Enum.join(Enum.take(tokens, 5), " "))}"})

  defp file([], found), do: found

  defp file(["syntax", "=", syntax, ";" | rest], found),
    do: file(rest, %{found | proto3?: unquoted(syntax) == "proto3"})

  defp file(["package", name, ";" | rest], found), do: file(rest, %{found | package: name})
  defp file([";" | rest], found), do: file(rest, found)

  defp file([word | rest], found) when word in ["import", "option"],
    do: file(past(rest), found)

  defp file([word | rest], found) when word in ["service", "extend"],
    do: file(past_block(rest), found)

  defp file(["message", name, "{" | rest], found) do
    {rest, found} = message(rest, whole(found.package, name), found, 0)
    file(rest, found)
  end

  defp file(["enum", name, "{" | rest], found) do
    {rest, found} = enum(rest, whole(found.package, name), found)
    file(rest, found)
  end

  defp file(tokens, _found), do: odd(tokens)

  defp unquoted(text), do: String.slice(text, 1..-2//1)
  defp whole("", name), do: name
  defp whole(scope, name), do: scope <> "." <> name

  # Skips to the position after the next semicolon, and over any nested block in braces.
  defp past([";" | rest]), do: rest
  defp past(["{" | rest]), do: rest |> block(1) |> past()
  defp past([_ | rest]), do: past(rest)
  defp past([]), do: fail("a statement does not end")

  defp past_block(["{" | rest]), do: block(rest, 1)
  defp past_block([_ | rest]), do: past_block(rest)
  defp past_block([]), do: fail("a block does not begin")

  defp block(rest, 0), do: rest
  defp block(["{" | rest], depth), do: block(rest, depth + 1)
  defp block(["}" | rest], depth), do: block(rest, depth - 1)
  defp block([_ | rest], depth), do: block(rest, depth)
  defp block([], _depth), do: fail("a block does not end")

  defp message(_tokens, name, _found, depth) when depth > @deepest,
    do: fail("#{name} is nested deeper than #{@deepest} messages")

  defp message(tokens, name, found, depth) do
    {rest, found, fields} = body(tokens, name, found, [], nil, depth)
    {rest, %{found | messages: [{name, Enum.reverse(fields), false} | found.messages]}}
  end

  defp body(["}" | rest], _name, found, fields, _oneof, _depth), do: {rest, found, fields}

  defp body([";" | rest], name, found, fields, oneof, depth),
    do: body(rest, name, found, fields, oneof, depth)

  defp body(["message", inner, "{" | rest], name, found, fields, nil, depth) do
    {rest, found} = message(rest, whole(name, inner), found, depth + 1)
    body(rest, name, found, fields, nil, depth)
  end

  defp body(["enum", inner, "{" | rest], name, found, fields, nil, depth) do
    {rest, found} = enum(rest, whole(name, inner), found)
    body(rest, name, found, fields, nil, depth)
  end

  defp body(["oneof", oneof, "{" | rest], name, found, fields, nil, depth) do
    {rest, found, fields} = body(rest, name, found, fields, oneof, depth)
    body(rest, name, found, fields, nil, depth)
  end

  defp body(["map", "<", key, ",", type, ">", field | rest], name, found, fields, nil, depth) do
    entry = whole(name, Macro.camelize(field) <> "Entry")
    value = %Field{name: "value", number: 2, type: {:unresolved, type, name}}
    key = %Field{name: "key", number: 1, type: {:unresolved, key, name}}
    {number, _options, rest} = ending(rest)
    field = %Field{name: field, number: number, type: {:message, entry}, repeated?: true}
    found = %{found | messages: [{entry, [key, value], true} | found.messages]}
    body(rest, name, found, [field | fields], nil, depth)
  end

  defp body([word | rest], name, found, fields, oneof, depth)
       when word in ["option", "reserved", "extensions"],
       do: body(past(rest), name, found, fields, oneof, depth)

  defp body(["extend" | rest], name, found, fields, oneof, depth),
    do: body(past_block(rest), name, found, fields, oneof, depth)

  defp body([label, type, field, "=" | _] = tokens, name, found, fields, oneof, depth)
       when label in ["optional", "required", "repeated"] and type != "group" do
    {number, options, rest} = tokens |> Enum.drop(3) |> ending()
    field = field(type, field, number, name, label, options, oneof, found.proto3?)
    body(rest, name, found, [field | fields], oneof, depth)
  end

  defp body([type, field, "=" | _] = tokens, name, found, fields, oneof, depth) do
    {number, options, rest} = tokens |> Enum.drop(2) |> ending()
    field = field(type, field, number, name, nil, options, oneof, found.proto3?)
    body(rest, name, found, [field | fields], oneof, depth)
  end

  defp body([], name, _found, _fields, _oneof, _depth), do: fail("#{name} does not end")
  defp body(tokens, _name, _found, _fields, _oneof, _depth), do: odd(tokens)

  defp field(type, name, number, scope, label, options, oneof, proto3?) do
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

  defp ending(["=", number, ";" | rest]), do: {integer(number), [], rest}

  defp ending(["=", number, "[" | rest]) do
    {options, after_options} = Enum.split_while(rest, &(&1 != ";"))
    packed = Enum.chunk_every(options, 3, 1)

    options =
      cond do
        ["packed", "=", "true"] in packed -> [packed: true]
        ["packed", "=", "false"] in packed -> [packed: false]
        true -> []
      end

    case after_options do
      [";" | rest] -> {integer(number), options, rest}
      [] -> fail("a field does not end")
    end
  end

  defp ending(tokens), do: odd(tokens)

  defp integer(text) do
    case Integer.parse(text) do
      {0, "x" <> digits} -> hexadecimal(digits)
      {n, ""} -> n
      _ -> fail("#{inspect(text)} is not a number")
    end
  end

  defp hexadecimal(digits) do
    case Integer.parse(digits, 16) do
      {n, ""} -> n
      _ -> fail("0x#{digits} is not a number")
    end
  end

  defp enum(tokens, name, found) do
    {rest, values} = values(tokens, name, [])
    {rest, %{found | enums: [{name, Enum.reverse(values)} | found.enums]}}
  end

  defp values(["}" | rest], _name, values), do: {rest, values}
  defp values([";" | rest], name, values), do: values(rest, name, values)

  defp values([word | rest], name, values) when word in ["option", "reserved"],
    do: values(past(rest), name, values)

  defp values([value, "=" | _] = tokens, name, values) do
    {number, _options, rest} = tokens |> Enum.drop(1) |> ending()
    values(rest, name, [{value, number} | values])
  end

  defp values([], name, _values), do: fail("#{name} does not end")
  defp values(tokens, _name, _values), do: odd(tokens)

  # A type name is resolved from the innermost scope outwards.
  defp resolved(found) do
    messages = MapSet.new(found.messages, &elem(&1, 0))
    enums = MapSet.new(found.enums, &elem(&1, 0))

    for {name, fields, map?} <- Enum.reverse(found.messages) do
      {name, Enum.map(fields, &typed(&1, messages, enums)), map?}
    end
  end

  defp typed(%{type: {:unresolved, name, scope}} = field, messages, enums) do
    case Schema.scalar(name) do
      {:ok, type} -> scalar(%{field | type: type})
      :error -> named(field, lookup(name, scope, messages, enums))
    end
  end

  defp typed(field, _messages, _enums), do: field

  defp scalar(%{type: type} = field) when type in [:string, :bytes], do: %{field | packed?: false}
  defp scalar(field), do: field

  defp named(field, {:enum, _} = type), do: %{field | type: type}
  defp named(field, type), do: %{field | type: type, packed?: false}

  # A fully qualified name of an unknown type is kept: `also` may define it.
  defp lookup("." <> name, _scope, _messages, enums),
    do: if(name in enums, do: {:enum, name}, else: {:message, name})

  defp lookup(name, scope, messages, enums) do
    names = name |> outwards(scope) |> Enum.reverse()

    cond do
      found = Enum.find(names, &(&1 in messages)) -> {:message, found}
      found = Enum.find(names, &(&1 in enums)) -> {:enum, found}
      true -> {:message, name}
    end
  end

  defp outwards(name, scope) do
    scope
    |> String.split(".", trim: true)
    |> Enum.scan(&(&2 <> "." <> &1))
    |> Enum.map(&(&1 <> "." <> name))
    |> then(&[name | &1])
  end
end
