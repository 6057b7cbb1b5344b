defmodule Situ.Type do
  @moduledoc """
  Types of ports. They decide whether an output may be connected to an input, and whether a value is valid.

  A type is `:any`, `:integer`, `:float`, `:number`, `:boolean`, `:string`, `:binary`, `:atom`, `:map`, `:pid`, a
  struct's module, `{:list, t}`, `{:tuple, [t]}`, `{:map, key, value}`, `{:optional, t}` (the type or `nil`),
  `{:in, values}`, `{:or, [t]}` or `{:message, t}` (a `Situ.Message` whose data has type `t`).

      iex> Situ.Type.accepts?(:number, :integer)
      true
      iex> Situ.Type.accepts?({:list, :string}, {:list, :integer})
      false
      iex> Situ.Type.valid_value?({:optional, :float}, nil)
      true
      iex> Situ.Type.to_string({:list, {:optional, Situ.Message}})
      "list of Situ.Message or nil"
  """

  @type t :: atom() | {atom(), term()} | {:map, t(), t()}

  @simple [:any, :integer, :float, :number, :boolean, :string, :binary, :atom, :map, :list] ++
            [:tuple, :function, :pid]

  @doc "Returns whether an output of type `from` may feed an input of type `to`. `:any` on either side always matches."
  @spec accepts?(to :: t(), from :: t()) :: boolean()
  def accepts?(:any, _from), do: true
  def accepts?(_to, :any), do: true
  def accepts?(same, same), do: true
  def accepts?(:number, from) when from in [:integer, :float], do: true
  def accepts?(:string, :binary), do: true
  def accepts?(:binary, :string), do: true
  def accepts?(:list, {:list, _}), do: true
  def accepts?({:list, _}, :list), do: true
  def accepts?(:tuple, {:tuple, _}), do: true
  def accepts?({:tuple, _}, :tuple), do: true
  def accepts?(:map, {:map, _, _}), do: true
  def accepts?({:map, _, _}, :map), do: true
  def accepts?(:map, from) when is_atom(from) and from not in @simple, do: struct_module?(from)
  def accepts?(to, {:or, types}), do: Enum.all?(types, &accepts?(to, &1))
  def accepts?({:or, types}, from), do: Enum.any?(types, &accepts?(&1, from))
  def accepts?({:in, values}, {:in, given}), do: given -- values == []
  def accepts?(to, {:in, values}), do: Enum.all?(values, &valid_value?(to, &1))
  def accepts?({:list, to}, {:list, from}), do: accepts?(to, from)
  def accepts?({:message, to}, {:message, from}), do: accepts?(to, from)
  def accepts?({:message, _}, Situ.Message), do: true
  def accepts?(Situ.Message, {:message, _}), do: true
  def accepts?({:optional, to}, {:optional, from}), do: accepts?(to, from)
  def accepts?({:optional, to}, from), do: accepts?(to, from)
  def accepts?({:map, k, v}, {:map, fk, fv}), do: accepts?(k, fk) and accepts?(v, fv)

  def accepts?({:tuple, to}, {:tuple, from}) do
    length(to) == length(from) and
      to |> Enum.zip(from) |> Enum.all?(fn {t, f} -> accepts?(t, f) end)
  end

  def accepts?(_to, _from), do: false

  @doc "Returns whether `value` has the type; containers are checked element by element."
  @spec valid_value?(t(), term()) :: boolean()
  def valid_value?(:any, _), do: true
  def valid_value?(:integer, v), do: is_integer(v)
  def valid_value?(:float, v), do: is_float(v)
  def valid_value?(:number, v), do: is_number(v)
  def valid_value?(:boolean, v), do: is_boolean(v)
  def valid_value?(:string, v), do: is_binary(v)
  def valid_value?(:binary, v), do: is_binary(v)
  def valid_value?(:atom, v), do: is_atom(v)
  def valid_value?(:map, v), do: is_map(v)
  def valid_value?(:list, v), do: is_list(v)
  def valid_value?(:tuple, v), do: is_tuple(v)
  def valid_value?(:function, v), do: is_function(v)
  def valid_value?(:pid, v), do: is_pid(v)
  def valid_value?({:list, type}, v), do: is_list(v) and Enum.all?(v, &valid_value?(type, &1))
  def valid_value?({:optional, type}, v), do: is_nil(v) or valid_value?(type, v)
  def valid_value?({:or, types}, v), do: Enum.any?(types, &valid_value?(&1, v))
  def valid_value?({:in, values}, v), do: v in values

  def valid_value?({:message, type}, v),
    do: is_struct(v, Situ.Message) and valid_value?(type, v.data)

  def valid_value?({:map, k, v}, map) do
    is_map(map) and
      Enum.all?(map, fn {key, value} -> valid_value?(k, key) and valid_value?(v, value) end)
  end

  def valid_value?({:tuple, types}, v) do
    is_tuple(v) and tuple_size(v) == length(types) and
      types |> Enum.zip(Tuple.to_list(v)) |> Enum.all?(fn {t, e} -> valid_value?(t, e) end)
  end

  def valid_value?(module, v) when is_atom(module), do: is_struct(v, module)
  def valid_value?(_type, _v), do: false

  @doc "Returns whether a term is a valid type, so that adding a port fails early if it is not."
  @spec valid_type?(term()) :: boolean()
  def valid_type?(type) when is_atom(type), do: type not in [nil, true, false]
  def valid_type?({kind, type}) when kind in [:list, :optional, :message], do: valid_type?(type)
  def valid_type?({:in, values}), do: is_list(values)

  def valid_type?({kind, types}) when kind in [:tuple, :or],
    do: is_list(types) and Enum.all?(types, &valid_type?/1)

  def valid_type?({:map, k, v}), do: valid_type?(k) and valid_type?(v)
  def valid_type?(_), do: false

  @doc "Formats a type for errors and diagrams."
  @spec to_string(t()) :: String.t()
  def to_string({:list, t}), do: "list of " <> __MODULE__.to_string(t)
  def to_string({:optional, t}), do: __MODULE__.to_string(t) <> " or nil"
  def to_string({:message, t}), do: "message of " <> __MODULE__.to_string(t)
  def to_string({:tuple, ts}), do: "{" <> Enum.map_join(ts, ", ", &__MODULE__.to_string/1) <> "}"
  def to_string({:or, ts}), do: Enum.map_join(ts, " or ", &__MODULE__.to_string/1)
  def to_string({:in, values}), do: "one of " <> Enum.map_join(values, ", ", &inspect/1)

  def to_string({:map, k, v}),
    do: "map of #{__MODULE__.to_string(k)} to #{__MODULE__.to_string(v)}"

  def to_string(t) when t in @simple, do: Atom.to_string(t)
  def to_string(t), do: inspect(t)

  defp struct_module?(module),
    do: Situ.KnownModules.ensure_loaded?(module) and function_exported?(module, :__struct__, 0)
end
