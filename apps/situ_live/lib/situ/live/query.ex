defmodule Situ.Live.Query do
  @moduledoc false
  # Decodes query strings and URL-encoded forms such as `a=1&b[c]=2&d[]=3` into nested maps and
  # lists.
  #
  # Input is untrusted: keys remain strings, at most 1,000 fields and 8 levels are accepted, and
  # strings must be UTF-8.
  @max_fields 1_000
  @max_depth 8

  @doc """
  Decodes a query string; later fields override earlier ones of the same name.

      iex> Situ.Live.Query.parse("a=1&b[c]=x+y&d[]=3&d[]=4")
      {:ok, %{"a" => "1", "b" => %{"c" => "x y"}, "d" => ["3", "4"]}}
      iex> Situ.Live.Query.parse("a=%ff")
      {:error, :bad_query}
  """
  @spec parse(String.t()) :: {:ok, map()} | {:error, :bad_query}
  def parse(""), do: {:ok, %{}}

  def parse(text) when is_binary(text) do
    fields = :binary.split(text, "&", [:global])

    if length(fields) > @max_fields,
      do: {:error, :bad_query},
      else: collect_fields(fields, %{})
  end

  defp collect_fields([], acc), do: {:ok, acc |> unwrap_lists()}
  defp collect_fields(["" | rest], acc), do: collect_fields(rest, acc)

  defp collect_fields([field | rest], acc) do
    {name, value} =
      case :binary.split(field, "=") do
        [name, value] -> {form_decode(name), form_decode(value)}
        [name] -> {form_decode(name), ""}
      end

    with true <- is_binary(name) and is_binary(value),
         path when is_list(path) <- field_path(name) do
      collect_fields(rest, put_field(acc, path, value))
    else
      _ -> {:error, :bad_query}
    end
  end

  @doc """
  Returns the path of a field within the result of `parse/1`. A name without brackets is used unchanged.

      iex> Situ.Live.Query.field_path("a[b][]")
      ["a", "b", ""]
  """
  @spec field_path(String.t()) :: [String.t()] | :error
  def field_path(name) do
    case :binary.split(name, "[") do
      [head, tail] when head != "" ->
        inner = tail |> String.trim_trailing("]") |> String.split("][")
        if length(inner) > @max_depth, do: :error, else: [head | inner]

      _ ->
        [name]
    end
  end

  # Lists are collected in reverse under a marker, so that n values take n steps.
  defp put_field(acc, [key], value), do: Map.put(acc, key, value)

  defp put_field(acc, [key, ""], value) do
    case acc do
      %{^key => {:list, values}} -> %{acc | key => {:list, [value | values]}}
      _ -> Map.put(acc, key, {:list, [value]})
    end
  end

  defp put_field(acc, [key | rest], value) do
    inner =
      case acc do
        %{^key => %{} = inner} -> inner
        _ -> %{}
      end

    Map.put(acc, key, put_field(inner, rest, value))
  end

  defp unwrap_lists({:list, values}), do: Enum.reverse(values)

  defp unwrap_lists(%{} = map),
    do: Map.new(map, fn {key, value} -> {key, unwrap_lists(value)} end)

  defp unwrap_lists(value), do: value

  defp form_decode(text), do: text |> :binary.replace("+", " ", [:global]) |> percent_decode()

  @doc "Percent-decodes a string; returns `:error` if it is malformed or not UTF-8."
  @spec percent_decode(String.t()) :: String.t() | :error
  def percent_decode(text) do
    decoded = URI.decode(text)
    if String.valid?(decoded), do: decoded, else: :error
  rescue
    ArgumentError -> :error
  end

  @doc """
  Encodes a map (strings, numbers, atoms; nested maps and lists) as a query string.

      iex> Situ.Live.Query.encode(%{"a" => 1, "b" => %{"c" => "x y"}})
      "a=1&b%5Bc%5D=x+y"
  """
  @spec encode(map() | keyword()) :: String.t()
  def encode(params) do
    params
    |> Enum.flat_map(fn {key, value} -> flatten_pairs(to_string(key), value) end)
    |> URI.encode_query()
  end

  @doc """
  Returns the name of the field at a path; the inverse of `field_path/1`.

      iex> Situ.Live.Query.field_name(["a", "b"])
      "a[b]"
  """
  @spec field_name([String.t(), ...]) :: String.t()
  def field_name([head | inner]), do: head <> Enum.map_join(inner, &"[#{&1}]")

  defp flatten_pairs(key, %{} = map),
    do: Enum.flat_map(map, fn {k, v} -> flatten_pairs("#{key}[#{k}]", v) end)

  defp flatten_pairs(key, list) when is_list(list),
    do: Enum.flat_map(list, &flatten_pairs(key <> "[]", &1))

  defp flatten_pairs(key, value), do: [{key, value}]
end
