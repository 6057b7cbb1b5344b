defmodule Situ.Bridge.Ros.Definition do
  @moduledoc false
  # Parses message definitions of ROS 1 and ROS 2 (`.msg`), as found in files, bags and MCAP. A definition consists
  # of a type and, separated by lines of `=`, the types that it contains.
  #
  # The type of a field is a primitive (`:bool`, `:int8` ... `:float64`, `:string`, `:time`, `:duration`),
  # `{:message, name}`, `{:array, type, n}` or `{:list, type}`. Type names do not contain the `msg/` that ROS 2
  # inserts.
  alias Situ.Bridge.Ros.Library

  @enforce_keys [:name, :types, :text]
  defstruct [:name, :types, :text]

  @type field_type ::
          atom()
          | {:message, String.t()}
          | {:array, field_type(), pos_integer()}
          | {:list, field_type()}
  @type message :: %{
          fields: [{String.t(), field_type()}],
          texts: [String.t()],
          constants: [{type :: String.t(), name :: String.t(), value :: String.t()}]
        }
  @type t :: %__MODULE__{name: String.t(), types: %{String.t() => message()}, text: String.t()}

  @primitives %{
    "bool" => :bool,
    "int8" => :int8,
    "byte" => :int8,
    "uint8" => :uint8,
    "char" => :uint8,
    "int16" => :int16,
    "uint16" => :uint16,
    "int32" => :int32,
    "uint32" => :uint32,
    "int64" => :int64,
    "uint64" => :uint64,
    "float32" => :float32,
    "float64" => :float64,
    "string" => :string,
    "wstring" => :wstring,
    "time" => :time,
    "duration" => :duration
  }
  @max_types 1_000

  @doc """
  Parses a definition. Types that the text does not define are looked up in the standard types of ROS 1 or ROS 2
  (`Situ.Bridge.Ros.Library`). Errors are sentences that describe a malformed line, an unknown type, or a type that
  contains itself.

      iex> alias Situ.Bridge.Ros.Definition
      iex> {:ok, definition} = Definition.parse("geometry_msgs/Point", "float64 x\\nfloat64 y\\nfloat64 z")
      iex> definition.types["geometry_msgs/Point"].fields
      [{"x", :float64}, {"y", :float64}, {"z", :float64}]
      iex> Definition.md5(definition)
      "4a842b65f413084dc2b10fb484ea7f17"
  """
  @spec parse(String.t(), String.t(), Library.dialect()) :: {:ok, t()} | {:error, String.t()}
  def parse(name, text, dialect \\ :ros1) do
    name = strip_kind(name)

    with {:ok, types} <- parse_sections(name, text),
         {:ok, types} <- resolve_types({name, dialect}, types, [name]),
         :ok <- check_finite(name, types, []) do
      {:ok, %__MODULE__{name: name, types: fill_empty_types(types, dialect), text: text}}
    end
  end

  # ROS 2 adds a member to a type whose definition is empty.
  defp fill_empty_types(types, :ros1), do: types

  defp fill_empty_types(types, :ros2) do
    Map.new(types, fn
      {name, %{fields: []} = type} ->
        {name,
         %{type | fields: [{"structure_needs_at_least_one_member", :uint8}], texts: ["uint8"]}}

      other ->
        other
    end)
  end

  @doc """
  Parses a service (`.srv`: a request, a line `---`, a response). Returns its two types and its MD5 sum, which only
  ROS 1 needs.

      iex> text = "bool data\\n---\\nbool success\\nstring message"
      iex> {:ok, service} = Situ.Bridge.Ros.Definition.parse_service("std_srvs/SetBool", text)
      iex> service.md5
      "09fb03525b03e7ea1fd3992bafd87e16"
  """
  @spec parse_service(String.t(), String.t(), Library.dialect()) ::
          {:ok, %{request: t(), response: t(), md5: String.t()}} | {:error, String.t()}
  def parse_service(name, text, dialect \\ :ros1) do
    name = if dialect == :ros1, do: name, else: strip_kind(name) <> "_"

    with [request, response] <- Regex.split(~r/^---\s*$/m, text, parts: 2),
         {:ok, request} <- parse(name <> "Request", request, dialect),
         {:ok, response} <- parse(name <> "Response", response, dialect) do
      texts = for d <- [request, response], do: md5_text(d.name, d.types)
      {:ok, %{request: request, response: response, md5: hash_text(texts)}}
    else
      [_] -> {:error, "the line --- between the request and the response is missing"}
      error -> error
    end
  end

  @doc "Returns a type's name without `msg/` or `srv/`."
  @spec strip_kind(String.t()) :: String.t()
  def strip_kind(name) do
    case String.split(name, "/") do
      [package, kind, type] when kind in ["msg", "srv", "action"] -> package <> "/" <> type
      _ -> name
    end
  end

  defp parse_sections(name, text) do
    [first | rest] = Regex.split(~r/^={20,}\s*$/m, text)
    with {:ok, types} <- parse_section(name, first, %{}), do: parse_other_sections(rest, types)
  end

  defp parse_other_sections(parts, types) do
    Enum.reduce_while(parts, {:ok, types}, fn part, {:ok, types} ->
      case Regex.run(~r/\A\s*(?:MSG|IDL):\s*(\S+)[^\n]*\n?(.*)\z/s, part) do
        [_, name, body] ->
          name |> strip_kind() |> parse_section(body, types) |> check_type_count()

        nil ->
          {:halt, {:error, "a part of the definition does not begin with MSG:"}}
      end
    end)
  end

  defp check_type_count({:ok, types}) when map_size(types) <= @max_types,
    do: {:cont, {:ok, types}}

  defp check_type_count({:ok, _}),
    do: {:halt, {:error, "the definition has more than #{@max_types} types"}}

  defp check_type_count(error), do: {:halt, error}

  defp parse_section(name, text, types) do
    package = name |> String.split("/") |> hd()

    text
    |> String.split(["\r\n", "\n"])
    |> Enum.reduce_while({:ok, %{fields: [], texts: [], constants: []}}, fn line,
                                                                            {:ok, message} ->
      case parse_line(line, package) do
        nil ->
          {:cont, {:ok, message}}

        {:field, field, text} ->
          {:cont,
           {:ok, %{message | fields: [field | message.fields], texts: [text | message.texts]}}}

        {:constant, constant} ->
          {:cont, {:ok, %{message | constants: [constant | message.constants]}}}

        :error ->
          {:halt, {:error, describe_bad_line(name, line)}}
      end
    end)
    |> case do
      {:ok, message} ->
        {:ok,
         Map.put(types, name, Map.new(message, fn {key, list} -> {key, Enum.reverse(list)} end))}

      error ->
        error
    end
  end

  # A definition comes from a file or a peer, so a name or a line may be invalid UTF-8, on which
  # String.slice/3 may raise.
  defp describe_bad_line(name, line) do
    name = if String.valid?(name), do: name, else: inspect(name, limit: 80)

    if String.valid?(line),
      do: "#{name} has the invalid line #{inspect(String.slice(line, 0, 80))}",
      else: "#{name} has the line #{inspect(line, limit: 80)}, which is not valid UTF-8"
  end

  # A string constant extends to the end of its line, including any `#`.
  defp parse_line(line, package) do
    case Regex.run(~r/\A\s*w?string(?:<=\d+)?\s+([A-Za-z]\w*)\s*=(.*)\z/, line) do
      [_, name, value] ->
        {:constant, {"string", name, String.trim(value)}}

      nil ->
        line |> String.split("#", parts: 2) |> hd() |> String.trim() |> parse_statement(package)
    end
  end

  defp parse_statement("", _package), do: nil

  defp parse_statement(text, package) do
    case Regex.run(
           ~r/\A([\w\/]+(?:<=\d+)?(?:\[[^\]]*\])?)\s+([A-Za-z]\w*)\s*(?:(=)\s*(\S.*)|\s(\S.*))?\z/,
           text
         ) do
      [_, type, name, "=", value] -> {:constant, {type, name, String.trim(value)}}
      [_, type, name | _default] -> parse_field(type, name, package)
      nil -> :error
    end
  end

  defp parse_field(type, name, package) do
    with {:field, {name, parsed}} <- parse_field_type(type, name, package),
         do: {:field, {name, parsed}, type}
  end

  defp parse_field_type(type, name, package) do
    case Regex.run(~r/\A([\w\/]+?)(?:<=\d+)?(?:\[(<=)?(\d*)\])?\z/, type) do
      [_, base] ->
        {:field, {name, base_type(base, package)}}

      [_, base, _, ""] ->
        {:field, {name, {:list, base_type(base, package)}}}

      [_, base, "<=", _] ->
        {:field, {name, {:list, base_type(base, package)}}}

      [_, base, "", n] ->
        {:field, {name, {:array, base_type(base, package), String.to_integer(n)}}}

      nil ->
        :error
    end
  end

  defp base_type(name, package) do
    cond do
      is_map_key(@primitives, name) -> @primitives[name]
      name == "Header" -> {:message, "std_msgs/Header"}
      String.contains?(name, "/") -> {:message, strip_kind(name)}
      true -> {:message, package <> "/" <> name}
    end
  end

  # Ensures that every type in use is defined by the text or is a standard type.
  defp resolve_types(_root, types, []), do: {:ok, types}

  defp resolve_types(root, types, [name | rest]) do
    with {:ok, types} <- ensure_type(name, types, elem(root, 1)) do
      new =
        for {_, type} <- types[name].fields,
            inner = inner_type(type),
            not is_map_key(types, inner),
            do: inner

      nested =
        for {_, type} <- types[name].fields,
            inner = inner_type(type),
            is_map_key(types, inner),
            not visited?(types, inner),
            do: inner

      resolve_types(root, mark_visited(types, name), Enum.uniq(new ++ nested) ++ rest)
    end
  end

  defp visited?(types, name), do: Map.get(types[name], :visited, false)
  defp mark_visited(types, name), do: Map.update!(types, name, &Map.put(&1, :visited, true))

  defp ensure_type(name, types, _dialect) when is_map_key(types, name), do: {:ok, types}

  defp ensure_type(name, types, dialect) do
    case Library.fetch(name, dialect) do
      {:ok, text} when map_size(types) <= @max_types -> parse_section(name, text, types)
      _ -> {:error, "the type #{name} is not defined"}
    end
  end

  defp inner_type({:message, name}), do: name
  defp inner_type({:array, type, _}), do: inner_type(type)
  defp inner_type({:list, type}), do: inner_type(type)
  defp inner_type(_primitive), do: nil

  defp check_finite(name, types, parents) do
    if name in parents do
      {:error, "the type #{name} contains itself"}
    else
      types[name].fields
      |> Enum.map(&inner_type(elem(&1, 1)))
      |> Enum.uniq()
      |> Enum.reject(&is_nil/1)
      |> Enum.reduce_while(:ok, fn inner, :ok ->
        case check_finite(inner, types, [name | parents]) do
          :ok -> {:cont, :ok}
          error -> {:halt, error}
        end
      end)
    end
  end

  @doc "Returns the MD5 sum with which ROS 1 checks that both sides use the same type."
  @spec md5(t()) :: String.t()
  def md5(%__MODULE__{name: name, types: types}), do: hash_type(name, types)

  defp hash_type(name, types), do: name |> md5_text(types) |> hash_text()
  defp hash_text(text), do: :md5 |> :crypto.hash(text) |> Base.encode16(case: :lower)

  defp md5_text(name, types) do
    %{fields: fields, texts: texts, constants: constants} = Map.fetch!(types, name)
    constant_lines = for {type, name, value} <- constants, do: "#{type} #{name}=#{value}"
    Enum.join(constant_lines ++ Enum.zip_with(fields, texts, &md5_line(&1, &2, types)), "\n")
  end

  # A field with a message type is hashed with the MD5 sum of that type, without array brackets.
  defp md5_line({name, type}, text, types) do
    case inner_type(type) do
      nil -> "#{text |> String.split("<=") |> hd()} #{name}"
      message -> "#{hash_type(message, types)} #{name}"
    end
  end
end
