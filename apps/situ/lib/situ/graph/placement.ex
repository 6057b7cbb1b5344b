defmodule Situ.Graph.Placement do
  @moduledoc """
  The placement options of components and operators. Every component and operator accepts them in addition to its own
  options, in the same keyword list.

      iex> own = [gain: [type: :number, default: 1]]
      iex> Situ.Graph.Placement.split_options!([name: "Left", gain: 2], own, :operator)
      {[gain: 2], [name: "Left", async: false, on_error: :stop]}

  ## Components (`Situ.source/3`, `Situ.via/3`, `Situ.Pipeline.add/3`)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.options_for(:component))}

  ## Operators (`Situ.map/3`, `Situ.join/4` ...)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.options_for(:operator))}

  ## Generators (`Situ.from_enumerable/3` ...)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.options_for(:generator))}
  """
  # This module has the only table of these options. Before, 35 operators split one list by hand,
  # each with separate schemas for the check and for the documentation. An error about an unknown
  # option listed only half of the known ones. A component's option with a name from this table is
  # rejected.
  alias Situ.{Error, Options}
  alias Situ.Graph.Placement.Schema

  @type kind :: :component | :operator | :fusion | :generator

  @doc "Returns the option schema of a kind of element."
  @spec schema(kind()) :: Options.schema()
  defdelegate schema(kind), to: Schema, as: :options_for

  @doc """
  Validates `opts` against `own` and the options of the kind, and splits them into `{own, placement}`.

  Raises `Situ.Error`; the error for an unknown option lists the known options.
  """
  @spec split_options!(keyword(), Options.schema(), kind()) :: {keyword(), keyword()}
  def split_options!(opts, own, kind) do
    placement = schema(kind)
    Enum.each(Keyword.keys(own), &check_free!(&1, placement))
    opts |> Options.validate!(own ++ placement) |> Keyword.split(Keyword.keys(own))
  end

  @doc """
  Splits `opts` into placement options and all others without validation, for functions that validate their own
  options elsewhere.

      iex> Situ.Graph.Placement.split_unchecked([radius: 3, name: "Blur"], :operator)
      {[name: "Blur"], [radius: 3]}
  """
  @spec split_unchecked(keyword(), kind()) :: {keyword(), keyword()}
  def split_unchecked(opts, kind), do: Keyword.split(opts, Keyword.keys(schema(kind)))

  defp check_free!(key, placement) do
    if Keyword.has_key?(placement, key) do
      raise Error.new(
              :reserved_option,
              "the component declares the reserved option #{inspect(key)}",
              why: "#{inspect(key)} is a placement option of every component",
              fix: "rename the component's option"
            )
    end
  end
end
