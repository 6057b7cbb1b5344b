defmodule Situ.Bridge.Psi.Schema do
  @moduledoc false
  # Describes one type of the catalog: its members in the order in which they are written, and its serializer.
  import Bitwise
  alias Situ.Bridge.Psi.{Bytes, TypeName}

  @enforce_keys [:id, :name, :type_name]
  defstruct [:id, :name, :type_name, :serializer, :version, flags: 0, members: []]

  @type t :: %__MODULE__{
          id: integer(),
          name: String.t(),
          type_name: String.t(),
          serializer: String.t(),
          version: integer(),
          flags: non_neg_integer(),
          members: [{String.t(), type_name :: String.t()}]
        }

  @max_members 10_000

  @doc "Parses the schema that follows the header of an entry."
  @spec parse(map(), binary()) :: {:ok, t()} | :error
  def parse(header, <<n::little-signed-32, rest::binary>>) when n in 0..@max_members do
    with {:ok, members, rest} <- parse_members(n, rest, []) do
      {:ok,
       %__MODULE__{
         id: header.id &&& 0x3FFF_FFFF,
         name: header.name,
         type_name: header.type_name,
         serializer: serializer_name(header.serializer),
         version: header.version,
         flags: parse_flags(header.version, n, rest),
         members: members
       }}
    end
  end

  def parse(_header, _rest), do: :error

  defp parse_members(0, rest, members), do: {:ok, Enum.reverse(members), rest}

  defp parse_members(n, bytes, members) do
    with {:ok, name, rest} when is_binary(name) <- Bytes.parse_string(bytes),
         {:ok, type, <<_required, rest::binary>>} when is_binary(type) <- Bytes.parse_string(rest) do
      parse_members(n - 1, rest, [{property_name(name), type} | members])
    else
      _ -> :error
    end
  end

  # The compiler wraps the names of automatic properties as `<Name>k__BackingField`.
  defp property_name("<" <> rest = name) do
    case String.split(rest, ">") do
      [property, "k__BackingField"] -> property
      _ -> name
    end
  end

  defp property_name(name), do: name

  # "Microsoft.Psi.Serialization.ClassSerializer`1[[...]]" -> "ClassSerializer"
  defp serializer_name(name) do
    TypeName.parse(name).name
    |> String.replace_prefix("Microsoft.Psi.Serialization.", "")
    |> String.replace(~r/`\d+/, "")
  end

  defp parse_flags(version, n, <<flags::little-32, _::binary>>) when version >= 2 and n > 0,
    do: flags

  defp parse_flags(_version, _n, _rest), do: 0

  def enum?(%{members: members}), do: match?([{"value__", _}], members)
  def class?(%{flags: flags}), do: (flags &&& 0x0D) != 0
  def struct?(%{flags: flags}), do: (flags &&& 0x02) != 0
end
