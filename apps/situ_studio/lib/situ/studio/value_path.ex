defmodule Situ.Studio.ValuePath do
  @moduledoc false
  # Paths to a value within a message: `.rect.x`, `[0].score`, `["left"]`.
  #
  # A name after a dot is a field of a struct or a key of a map (atom or string). A number in
  # brackets is an index into a list or tuple. A quoted name in brackets is a string key with
  # characters that a dotted name cannot contain. Parsing never creates atoms.
  alias Situ.Error

  @type step :: {:name, String.t()} | {:at, non_neg_integer()}
  @type t :: [step()]

  @max_bytes 512

  @doc """
  Parses a path into its steps; `""` is the message itself.

      iex> {:ok, path} = Situ.Studio.ValuePath.parse(".faces[1].score")
      iex> Situ.Studio.ValuePath.fetch(%{faces: [%{score: 0.1}, %{score: 0.9}]}, path)
      {:ok, 0.9}
      iex> Situ.Studio.ValuePath.fetch(%{faces: []}, path)
      :error
      iex> {:error, error} = Situ.Studio.ValuePath.parse("faces")
      iex> error.code
      :bad_path
  """
  @spec parse(String.t()) :: {:ok, t()} | {:error, Error.t()}
  def parse(text) when is_binary(text) and byte_size(text) <= @max_bytes do
    case parse_steps(text, []) do
      {:ok, path} ->
        {:ok, path}

      :error ->
        {:error,
         Error.new(:bad_path, "invalid path: #{inspect(text)}",
           fix: "use the form .rect.x, [0].score or [\"left\"]"
         )}
    end
  end

  def parse(_), do: {:error, Error.new(:bad_path, "a path has at most #{@max_bytes} bytes")}

  defp parse_steps("", path), do: {:ok, Enum.reverse(path)}

  defp parse_steps("." <> rest, path) do
    case Regex.run(~r/\A([^.\[\]"]+)(.*)\z/su, rest, capture: :all_but_first) do
      [name, rest] -> parse_steps(rest, [{:name, name} | path])
      nil -> :error
    end
  end

  defp parse_steps("[\"" <> rest, path) do
    case String.split(rest, "\"]", parts: 2) do
      [name, rest] -> parse_steps(rest, [{:name, name} | path])
      _ -> :error
    end
  end

  defp parse_steps("[" <> rest, path) do
    case Regex.run(~r/\A(\d{1,9})\](.*)\z/s, rest, capture: :all_but_first) do
      [index, rest] -> parse_steps(rest, [{:at, String.to_integer(index)} | path])
      nil -> :error
    end
  end

  defp parse_steps(_, _), do: :error

  @doc "Returns the value at `path` in `term`."
  @spec fetch(term(), t()) :: {:ok, term()} | :error
  def fetch(term, []), do: {:ok, term}

  def fetch(%_{} = struct, path), do: struct |> Map.from_struct() |> fetch(path)

  def fetch(map, [{:name, name} | rest]) when is_map(map) do
    case Enum.find(map, fn {key, _} -> key_name(key) == name end) do
      {_, value} -> fetch(value, rest)
      nil -> :error
    end
  end

  def fetch(list, [{:at, index} | rest]) when is_list(list) do
    case Enum.fetch(list, index) do
      {:ok, value} -> fetch(value, rest)
      :error -> :error
    end
  rescue
    # Enum.fetch/2 raises for an improper list.
    FunctionClauseError -> :error
  end

  def fetch(tuple, [{:at, index} | rest]) when is_tuple(tuple) and index < tuple_size(tuple),
    do: fetch(elem(tuple, index), rest)

  def fetch(map, [{:at, index} | rest]) when is_map(map) and is_map_key(map, index),
    do: fetch(Map.fetch!(map, index), rest)

  def fetch(_, _), do: :error

  @doc """
  Appends a step to a path, for a child of a displayed value; `nil` if the key cannot be written in a path.

      iex> Situ.Studio.ValuePath.child_path(".a", :b)
      ".a.b"
      iex> Situ.Studio.ValuePath.child_path("", "with space.and dot")
      ~s(["with space.and dot"])
  """
  @spec child_path(String.t(), term()) :: String.t() | nil
  def child_path(path, index) when is_integer(index) and index >= 0, do: "#{path}[#{index}]"

  def child_path(path, key) when is_atom(key) or is_binary(key) do
    name = key_name(key)

    cond do
      name =~ ~r/\A[\w?!-]+\z/u -> "#{path}.#{name}"
      String.valid?(name) and not String.contains?(name, "\"]") -> ~s(#{path}["#{name}"])
      true -> nil
    end
  end

  def child_path(_, _), do: nil

  defp key_name(key) when is_atom(key), do: Atom.to_string(key)
  defp key_name(key) when is_binary(key), do: key
  defp key_name(_), do: nil
end
