defmodule Situ.Bridge.Psi.TypeName do
  @moduledoc false
  # Parses .NET type names and removes the assemblies, which differ between frameworks and versions.

  # `arrays` is the number of array suffixes, for example 2 in `System.Int32[][]`.
  defstruct [:name, args: [], arrays: 0]

  @type t :: %__MODULE__{name: String.t(), args: [t()], arrays: non_neg_integer()}

  @max_depth 32

  @doc """
  Parses a name into its parts.

      iex> alias Situ.Bridge.Psi.TypeName
      iex> of = "[System.Int32, mscorlib, Version=4.0.0.0]"
      iex> list = TypeName.parse("System.Collections.Generic.List`1[" <> of <> "], mscorlib, Version=4.0.0.0")
      iex> {list.name, Enum.map(list.args, & &1.name)}
      {"System.Collections.Generic.List`1", ["System.Int32"]}
      iex> TypeName.parse("System.Byte[], mscorlib")
      %TypeName{name: "System.Byte", arrays: 1}
  """
  @spec parse(String.t()) :: t()
  def parse(text) do
    {type, _rest} = parse_type(text, 0)
    type
  end

  @doc """
  Returns the name without assemblies.

      iex> Situ.Bridge.Psi.TypeName.short_name("System.Nullable`1[[System.Double, mscorlib]], mscorlib")
      "System.Nullable`1[[System.Double]]"
  """
  @spec short_name(String.t() | t()) :: String.t()
  def short_name(text) when is_binary(text), do: text |> parse() |> short_name()

  def short_name(%__MODULE__{name: name, args: args, arrays: arrays}) do
    arguments =
      if args == [], do: "", else: "[" <> Enum.map_join(args, ",", &"[#{short_name(&1)}]") <> "]"

    name <> arguments <> String.duplicate("[]", arrays)
  end

  @doc "Returns the type of an array's elements."
  @spec element_type(t()) :: t()
  def element_type(%{arrays: n} = type) when n > 0, do: %{type | arrays: n - 1}

  defp parse_type(text, depth) when depth > @max_depth, do: {%__MODULE__{name: text}, ""}

  defp parse_type(text, depth) do
    {name, rest} = split_name(text)
    {args, rest} = parse_arguments(rest, depth)
    {arrays, rest} = count_arrays(rest, 0)
    {%__MODULE__{name: name, args: args, arrays: arrays}, skip_assembly(rest)}
  end

  defp split_name(text) do
    case :binary.match(text, ["[", "]", ","]) do
      {at, _} -> {binary_part(text, 0, at), binary_part(text, at, byte_size(text) - at)}
      :nomatch -> {text, ""}
    end
  end

  defp parse_arguments("[[" <> rest, depth), do: collect_arguments(rest, depth, [])
  defp parse_arguments(rest, _depth), do: {[], rest}

  defp collect_arguments(text, depth, args) do
    {type, rest} = parse_type(text, depth + 1)
    args = [type | args]

    case rest do
      "],[" <> rest -> collect_arguments(rest, depth, args)
      "]]" <> rest -> {Enum.reverse(args), rest}
      rest -> {Enum.reverse(args), rest}
    end
  end

  defp count_arrays("[]" <> rest, n), do: count_arrays(rest, n + 1)
  defp count_arrays(rest, n), do: {n, rest}

  # An assembly name extends to the bracket that closes the type argument.
  defp skip_assembly("," <> _ = text) do
    case :binary.match(text, "]") do
      {at, _} -> binary_part(text, at, byte_size(text) - at)
      :nomatch -> ""
    end
  end

  defp skip_assembly(rest), do: rest
end
