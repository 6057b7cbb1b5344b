defmodule Situ.Bridge.Ros.Definition do
  @moduledoc """
  Parses message definitions of ROS 1 and ROS 2 (`.msg`), as found in files, bags and MCAP. A definition consists of a
  type and, separated by lines of `=`, the types that it contains.

      iex> alias Situ.Bridge.Ros.Definition
      iex> {:ok, definition} = Definition.parse("geometry_msgs/Point", "float64 x\\nfloat64 y\\nfloat64 z")
      iex> definition.types["geometry_msgs/Point"].fields
      [{"x", :float64}, {"y", :float64}, {"z", :float64}]
      iex> Definition.md5(definition)
      "4a842b65f413084dc2b10fb484ea7f17"

  The type of a field is a primitive (`:bool`, `:int8` ... `:float64`, `:string`, `:time`, `:duration`), `{:message,
  name}`, `{:array, type, n}` or `{:list, type}`. Type names do not contain the `msg/` that ROS 2 inserts.
  """
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
          spelled: [String.t()],
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
  @most_types 1_000

  @doc """
  Parses a definition. Types that the text does not define are looked up in the standard types of ROS 1 or ROS 2
  (`Situ.Bridge.Ros.Library`). Errors are sentences that describe a malformed line, an unknown type, or a type that
  contains itself.
  """
  @spec parse(String.t(), String.t(), Library.dialect()) :: {:ok, t()} | {:error, String.t()}
  def parse(name, text, dialect \\ :ros1) do
    name = plain(name)

    with {:ok, types} <- sections(name, text),
         {:ok, types} <- complete({name, dialect}, types, [name]),
         :ok <- finite(name, types, []) do
      {:ok, %__MODULE__{name: name, types: never_empty(types, dialect), text: text}}
    end
  end

  # ROS 2 adds a member to a type whose definition is empty.
  defp never_empty(types, :ros1), do: types

  defp never_empty(types, :ros2) do
    Map.new(types, fn
      {name, %{fields: []} = type} ->
        {name,
         %{type | fields: [{"structure_needs_at_least_one_member", :uint8}], spelled: ["uint8"]}}

      other ->
        other
    end)
  end

  @doc """
  Parses a service (`.srv`: a request, a line `---`, a response). Returns its two types and its MD5 sum, which only
  ROS 1 needs.

      iex> text = "bool data\\n---\\nbool success\\nstring message"
      iex> {:ok, service} = Situ.Bridge.Ros.Definition.service("std_srvs/SetBool", text)
      iex> service.md5
      "09fb03525b03e7ea1fd3992bafd87e16"
  """
  @spec service(String.t(), String.t(), Library.dialect()) ::
          {:ok, %{request: t(), response: t(), md5: String.t()}} | {:error, String.t()}
  def service(name, text, dialect \\ :ros1) do
    name = if dialect == :ros1, do: name, else: plain(name) <> "_"

    with [request, response] <- Regex.split(~r/^---\s*$/m, text, parts: 2),
         {:ok, request} <- parse(name <> "Request", request, dialect),
         {:ok, response} <- parse(name <> "Response", response, dialect) do
      texts = for d <- [request, response], do: md5_text(d.name, d.types)
      {:ok, %{request: request, response: response, md5: sum(texts)}}
    else
      [_] -> {:error, "the line --- between the request and the response is missing"}
      error -> error
    end
  end

  @doc "Returns a type's name without `msg/` or `srv/`."
  @spec plain(String.t()) :: String.t()
  def plain(name) do
    case String.split(name, "/") do
      [package, kind, type] when kind in ["msg", "srv", "action"] -> package <> "/" <> type
      _ -> name
    end
  end

  defp sections(name, text) do
    [first | rest] = Regex.split(~r/^={20,}\s*$/m, text)
    with {:ok, types} <- section(name, first, %{}), do: others(rest, types)
  end

  defp others(parts, types) do
    Enum.reduce_while(parts, {:ok, types}, fn part, {:ok, types} ->
      case Regex.run(~r/\A\s*(?:MSG|IDL):\s*(\S+)[^\n]*\n?(.*)\z/s, part) do
        [_, name, body] -> name |> plain() |> section(body, types) |> go_on()
        nil -> {:halt, {:error, "a part of the definition does not begin with MSG:"}}
      end
    end)
  end

  defp go_on({:ok, types}) when map_size(types) <= @most_types, do: {:cont, {:ok, types}}
  defp go_on({:ok, _}), do: {:halt, {:error, "the definition has more than #{@most_types} types"}}
  defp go_on(error), do: {:halt, error}

  defp section(name, text, types) do
    package = name |> String.split("/") |> hd()

    text
    |> String.split(["\r\n", "\n"])
    |> Enum.reduce_while({:ok, %{fields: [], spelled: [], constants: []}}, fn line,
                                                                              {:ok, message} ->
      case line(line, package) do
        nil ->
          {:cont, {:ok, message}}

        {:field, field, text} ->
          {:cont,
           {:ok, %{message | fields: [field | message.fields], spelled: [text | message.spelled]}}}

        {:constant, constant} ->
          {:cont, {:ok, %{message | constants: [constant | message.constants]}}}

        :error ->
          {:halt, {:error, "#{name} has the invalid line #{inspect(String.slice(line, 0, 80))}"}}
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

  # A string constant extends to the end of its line, including any `#`.
  defp line(line, package) do
    case Regex.run(~r/\A\s*w?string(?:<=\d+)?\s+([A-Za-z]\w*)\s*=(.*)\z/, line) do
      [_, name, value] -> {:constant, {"string", name, String.trim(value)}}
      nil -> line |> String.split("#", parts: 2) |> hd() |> String.trim() |> statement(package)
    end
  end

  defp statement("", _package), do: nil

  defp statement(text, package) do
    case Regex.run(
           ~r/\A([\w\/]+(?:<=\d+)?(?:\[[^\]]*\])?)\s+([A-Za-z]\w*)\s*(?:(=)\s*(\S.*)|\s(\S.*))?\z/,
           text
         ) do
      [_, type, name, "=", value] -> {:constant, {type, name, String.trim(value)}}
      [_, type, name | _default] -> field(type, name, package)
      nil -> :error
    end
  end

  defp field(type, name, package) do
    with {:field, {name, parsed}} <- parsed(type, name, package),
         do: {:field, {name, parsed}, type}
  end

  defp parsed(type, name, package) do
    case Regex.run(~r/\A([\w\/]+?)(?:<=\d+)?(?:\[(<=)?(\d*)\])?\z/, type) do
      [_, base] -> {:field, {name, base(base, package)}}
      [_, base, _, ""] -> {:field, {name, {:list, base(base, package)}}}
      [_, base, "<=", _] -> {:field, {name, {:list, base(base, package)}}}
      [_, base, "", n] -> {:field, {name, {:array, base(base, package), String.to_integer(n)}}}
      nil -> :error
    end
  end

  defp base(name, package) do
    cond do
      is_map_key(@primitives, name) -> @primitives[name]
      name == "Header" -> {:message, "std_msgs/Header"}
      String.contains?(name, "/") -> {:message, plain(name)}
      true -> {:message, package <> "/" <> name}
    end
  end

  # Ensures that every type in use is defined by the text or is a standard type.
  defp complete(_root, types, []), do: {:ok, types}

  defp complete(root, types, [name | rest]) do
    with {:ok, types} <- known(name, types, elem(root, 1)) do
      new =
        for {_, type} <- types[name].fields,
            inner = inner(type),
            not is_map_key(types, inner),
            do: inner

      nested =
        for {_, type} <- types[name].fields,
            inner = inner(type),
            is_map_key(types, inner),
            not visited?(types, inner),
            do: inner

      complete(root, mark(types, name), Enum.uniq(new ++ nested) ++ rest)
    end
  end

  defp visited?(types, name), do: Map.get(types[name], :visited, false)
  defp mark(types, name), do: Map.update!(types, name, &Map.put(&1, :visited, true))

  defp known(name, types, _dialect) when is_map_key(types, name), do: {:ok, types}

  defp known(name, types, dialect) do
    case Library.fetch(name, dialect) do
      {:ok, text} when map_size(types) <= @most_types -> section(name, text, types)
      _ -> {:error, "the type #{name} is not defined"}
    end
  end

  defp inner({:message, name}), do: name
  defp inner({:array, type, _}), do: inner(type)
  defp inner({:list, type}), do: inner(type)
  defp inner(_primitive), do: nil

  defp finite(name, types, above) do
    if name in above do
      {:error, "the type #{name} contains itself"}
    else
      types[name].fields
      |> Enum.map(&inner(elem(&1, 1)))
      |> Enum.uniq()
      |> Enum.reject(&is_nil/1)
      |> Enum.reduce_while(:ok, fn inner, :ok ->
        case finite(inner, types, [name | above]) do
          :ok -> {:cont, :ok}
          error -> {:halt, error}
        end
      end)
    end
  end

  @doc "Returns the MD5 sum with which ROS 1 checks that both sides use the same type."
  @spec md5(t()) :: String.t()
  def md5(%__MODULE__{name: name, types: types}), do: md5(name, types)

  defp md5(name, types), do: name |> md5_text(types) |> sum()
  defp sum(text), do: :md5 |> :crypto.hash(text) |> Base.encode16(case: :lower)

  defp md5_text(name, types) do
    %{fields: fields, spelled: spelled, constants: constants} = Map.fetch!(types, name)
    fixed = for {type, name, value} <- constants, do: "#{type} #{name}=#{value}"
    Enum.join(fixed ++ Enum.zip_with(fields, spelled, &md5_line(&1, &2, types)), "\n")
  end

  # A field with a message type is hashed with the MD5 sum of that type, without array brackets.
  defp md5_line({name, type}, spelled, types) do
    case inner(type) do
      nil -> "#{spelled |> String.split("<=") |> hd()} #{name}"
      message -> "#{md5(message, types)} #{name}"
    end
  end
end
