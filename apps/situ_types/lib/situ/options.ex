defmodule Situ.Options do
  @moduledoc """
  Option schemas. One keyword list validates options, fills in defaults, generates documentation, and suggests the
  nearest name for a typo.

      schema = [
        rate: [type: :pos_integer, default: 16_000, doc: "Samples per second."],
        mode: [type: {:in, [:fast, :exact]}, default: :exact, doc: "How to resample."]
      ]

  Types: `:any`, `:atom`, `:boolean`, `:integer`, `:pos_integer`, `:non_neg_integer`, `:number`, `:float`, `:string`,
  `:list`, `:keyword`, `:map`, `:module`, `:pid`, `:time_ns` (an integer of nanoseconds), `{:in, values}`,
  `{:fun, arity}`, `{:list, type}`, `{:range, min, max}` (a number, both ends included), `{:integer, min, max}` (an
  integer, both ends included), `{:struct, module}`, `{:tuple, [type]}`, `{:or, [type]}` and `{:optional, type}` (the type or
  `nil`).
  """
  alias Situ.Error

  @type type :: atom() | tuple()
  @type schema :: [
          {atom(), [type: type(), default: term(), required: boolean(), doc: String.t() | false]}
        ]

  @doc """
  Validates `opts` against `schema` and returns them in the schema's order, with defaults filled in.

      iex> Situ.Options.validate([], rate: [type: :pos_integer, default: 16_000, doc: "Hz."])
      {:ok, [rate: 16_000]}
      iex> {:error, error} = Situ.Options.validate([raet: 1], rate: [type: :pos_integer])
      iex> {error.code, error.fix}
      {:unknown_option, "did you mean :rate? Known options: :rate"}
      iex> {:error, error} = Situ.Options.validate([rate: 0], rate: [type: :pos_integer])
      iex> error.what
      "option :rate must be a positive integer, got: 0"
  """
  @spec validate(keyword(), schema()) :: {:ok, keyword()} | {:error, Error.t()}
  def validate(opts, schema) do
    with :ok <- check_keyword(opts),
         :ok <- check_known(opts, schema) do
      collect(schema, opts, [])
    end
  end

  @doc "Like `validate/2`, but returns the options or raises the `Situ.Error`."
  @spec validate!(keyword(), schema()) :: keyword()
  def validate!(opts, schema) do
    case validate(opts, schema) do
      {:ok, valid} -> valid
      {:error, error} -> raise error
    end
  end

  @doc """
  Formats `schema` as a Markdown list to interpolate into a `@moduledoc`. Options with `doc: false` are omitted.

      iex> Situ.Options.docs(rate: [type: :pos_integer, default: 16_000, doc: "Samples per second."])
      "  * `:rate` (a positive integer, default `16000`) - Samples per second."
  """
  @spec docs(schema()) :: String.t()
  def docs(schema) do
    schema
    |> Enum.reject(&hidden?/1)
    |> Enum.map_join("\n", fn {key, spec} ->
      "  * `#{inspect(key)}` (#{describe(spec[:type] || :any)}#{presence(spec)})#{doc(spec[:doc])}"
    end)
  end

  @doc """
  Returns the name in `known` that is most similar to `name`, or `nil` if none is similar.

      iex> Situ.Options.nearest("tresh", ["threshold", "rate"])
      "threshold"
      iex> Situ.Options.nearest("xyz", ["threshold"])
      nil
  """
  @spec nearest(atom() | String.t(), [name]) :: name | nil when name: atom() | String.t()
  def nearest(name, known) do
    known
    |> Enum.map(&{String.jaro_distance(to_string(&1), to_string(name)), &1})
    |> Enum.filter(fn {distance, _} -> distance > 0.6 end)
    |> Enum.max_by(&elem(&1, 0), fn -> {0.0, nil} end)
    |> elem(1)
  end

  defp presence(spec) do
    cond do
      spec[:required] -> ", required"
      Keyword.has_key?(spec, :default) -> ", default `#{inspect(spec[:default])}`"
      true -> ""
    end
  end

  defp doc(nil), do: ""
  defp doc(text), do: " - " <> text

  defp check_keyword(opts) do
    if Keyword.keyword?(opts),
      do: :ok,
      else:
        {:error, Error.new(:bad_options, "options must be a keyword list, got: #{inspect(opts)}")}
  end

  defp hidden?({_key, spec}), do: spec[:doc] == false

  defp check_known(opts, schema) do
    case Enum.find(Keyword.keys(opts), &(not Keyword.has_key?(schema, &1))) do
      nil ->
        :ok

      bad ->
        known = schema |> Enum.reject(&hidden?/1) |> Keyword.keys()

        {:error,
         Error.new(:unknown_option, "unknown option #{inspect(bad)}", fix: hint(bad, known))}
    end
  end

  defp hint(_bad, []), do: "remove it: no options are supported here"

  defp hint(bad, known) do
    list = "Known options: " <> Enum.map_join(known, ", ", &inspect/1)

    case nearest(bad, known) do
      nil -> list
      near -> "did you mean #{inspect(near)}? " <> list
    end
  end

  defp collect([], _opts, valid), do: {:ok, Enum.reverse(valid)}

  defp collect([{key, spec} | rest], opts, valid) do
    case fetch(opts, key, spec) do
      {:ok, value} -> collect(rest, opts, [{key, value} | valid])
      :absent -> collect(rest, opts, valid)
      {:error, _} = error -> error
    end
  end

  defp fetch(opts, key, spec) do
    case {Keyword.fetch(opts, key), Keyword.fetch(spec, :default)} do
      {{:ok, value}, _} -> check_type(key, value, spec[:type] || :any)
      {:error, {:ok, default}} -> {:ok, default}
      {:error, :error} -> if spec[:required], do: missing(key, spec), else: :absent
    end
  end

  defp missing(key, spec) do
    {:error, Error.new(:missing_option, "option #{inspect(key)} is required", fix: spec[:doc])}
  end

  defp check_type(key, value, type) do
    if valid?(type, value) do
      {:ok, value}
    else
      what = "option #{inspect(key)} must be #{describe(type)}, got: #{inspect(value, limit: 8)}"
      {:error, Error.new(:bad_option, what, fix: suggestion(type, value))}
    end
  end

  # The module of a struct may suggest the intended value, such as `Situ.Delivery.latest()` for `:latest`.
  defp suggestion({:optional, type}, value), do: suggestion(type, value)
  defp suggestion({:or, types}, value), do: Enum.find_value(types, &suggestion(&1, value))
  defp suggestion({:list, type}, [value | _]), do: suggestion(type, value)

  defp suggestion({:struct, module}, value),
    do:
      if(Code.ensure_loaded?(module) and function_exported?(module, :suggest, 1),
        do: module.suggest(value)
      )

  defp suggestion(_type, _value), do: nil

  @doc """
  Returns whether `value` matches the option type `type`.

      iex> Situ.Options.valid?({:list, :pos_integer}, [1, 2])
      true
  """
  @spec valid?(type(), term()) :: boolean()
  def valid?(:any, _), do: true
  def valid?(:atom, v), do: is_atom(v)
  def valid?(:boolean, v), do: is_boolean(v)
  def valid?(:integer, v), do: is_integer(v)
  def valid?(:time_ns, v), do: is_integer(v)
  def valid?(:pos_integer, v), do: is_integer(v) and v > 0
  def valid?(:non_neg_integer, v), do: is_integer(v) and v >= 0
  def valid?(:number, v), do: is_number(v)
  def valid?(:float, v), do: is_float(v)
  def valid?(:string, v), do: is_binary(v)
  def valid?(:list, v), do: is_list(v)
  def valid?(:keyword, v), do: Keyword.keyword?(v)
  def valid?(:map, v), do: is_map(v)
  def valid?(:module, v), do: is_atom(v) and not is_nil(v) and not is_boolean(v)
  def valid?(:pid, v), do: is_pid(v)
  def valid?({:in, values}, v), do: v in values
  def valid?({:fun, arity}, v), do: is_function(v, arity)
  def valid?({:list, type}, v), do: is_list(v) and Enum.all?(v, &valid?(type, &1))
  def valid?({:range, min, max}, v), do: is_number(v) and v >= min and v <= max
  def valid?({:integer, min, max}, v), do: is_integer(v) and v >= min and v <= max
  def valid?({:struct, module}, v), do: is_struct(v, module)

  def valid?({:tuple, types}, v) do
    is_tuple(v) and tuple_size(v) == length(types) and
      types |> Enum.zip(Tuple.to_list(v)) |> Enum.all?(fn {t, e} -> valid?(t, e) end)
  end

  def valid?({:or, types}, v), do: Enum.any?(types, &valid?(&1, v))
  def valid?({:optional, type}, v), do: is_nil(v) or valid?(type, v)

  defp describe(:any), do: "anything"
  defp describe(:integer), do: "an integer"
  defp describe(:pos_integer), do: "a positive integer"
  defp describe(:non_neg_integer), do: "an integer of 0 or more"
  defp describe(:time_ns), do: "an integer of nanoseconds"
  defp describe(:keyword), do: "a keyword list"
  defp describe({:in, values}), do: "one of " <> Enum.map_join(values, ", ", &inspect/1)
  defp describe({:fun, arity}), do: "a function of #{arity} arguments"
  defp describe({:list, type}), do: "a list, each element #{describe(type)}"
  defp describe({:range, min, max}), do: "a number from #{min} to #{max}"
  defp describe({:integer, min, max}), do: "an integer from #{min} to #{max}"
  defp describe({:struct, module}), do: "a %#{inspect(module)}{}"
  defp describe({:tuple, types}), do: "a tuple of " <> Enum.map_join(types, ", ", &describe/1)
  defp describe({:or, types}), do: Enum.map_join(types, " or ", &describe/1)
  defp describe({:optional, type}), do: describe(type) <> " or nil"
  defp describe(type) when type in [:atom], do: "an atom"
  defp describe(type), do: "a " <> to_string(type)
end
