defmodule Situ.Graph.Placement do
  @moduledoc """
  How a component or operator is placed in a pipeline: the options that all of them take besides their own, in the
  same keyword list.

      iex> own = [gain: [type: :number, default: 1]]
      iex> Situ.Graph.Placement.split!([name: "Left", gain: 2], own, :operator)
      {[gain: 2], [name: "Left", async: false, on_error: :stop]}

  ## Components (`Situ.source/3`, `Situ.via/3`, `Situ.Pipeline.add/3`)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.of(:component))}

  ## Operators (`Situ.map/3`, `Situ.join/4` ...)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.of(:operator))}

  ## Generators (`Situ.from_enumerable/3` ...)

  #{Situ.Options.docs(Situ.Graph.Placement.Schema.of(:generator))}
  """
  alias Situ.{Error, Options}
  alias Situ.Graph.Placement.Schema

  @type kind :: :component | :operator | :fusion | :generator

  @doc "The options that everything of this kind takes."
  @spec schema(kind()) :: Options.schema()
  defdelegate schema(kind), to: Schema, as: :of

  @doc """
  Checks `opts` against `own` and the options of the kind, and returns the two apart: `{own, placement}`.

  Raises `Situ.Error`; an unknown name is answered with all that are known.
  """
  @spec split!(keyword(), Options.schema(), kind()) :: {keyword(), keyword()}
  def split!(opts, own, kind) do
    placement = schema(kind)
    Enum.each(Keyword.keys(own), &check_free!(&1, placement))
    opts |> Options.validate!(own ++ placement) |> Keyword.split(Keyword.keys(own))
  end

  @doc """
  The options of placement and all others, apart and unchecked: for functions whose own options are checked elsewhere.

      iex> Situ.Graph.Placement.apart([radius: 3, name: "Blur"], :operator)
      {[name: "Blur"], [radius: 3]}
  """
  @spec apart(keyword(), kind()) :: {keyword(), keyword()}
  def apart(opts, kind), do: Keyword.split(opts, Keyword.keys(schema(kind)))

  defp check_free!(key, placement) do
    if Keyword.has_key?(placement, key) do
      raise Error.new(:reserved_option, "the component declares an option #{inspect(key)}",
              why: "every component takes #{inspect(key)} already, for its placement",
              fix: "give the component's option another name"
            )
    end
  end
end
