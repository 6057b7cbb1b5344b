defmodule Situ.Studio.Comparison do
  @moduledoc """
  A recording compared with another one: both on one time axis, the second shifted so that their beginnings, or an event
  in each, fall together. An address names the second by `with` and the shift by `offset`, in ns.
  """
  alias Situ.Error
  alias Situ.Studio.{Catalog, Layout, Source, WholeNumber}
  alias Situ.Studio.Source.{Beside, Derived}

  @enforce_keys [:id, :title, :offset, :first, :second]
  defstruct [:id, :title, :offset, :first, :second]

  @typedoc "The second item, the shift of its times, and when each begins and ends by its own clock."
  @type t :: %__MODULE__{
          id: String.t(),
          title: String.t(),
          offset: Situ.Time.duration(),
          first: Source.extent(),
          second: Source.extent()
        }

  @doc "Opens an item, with the one that `params` compares it with, if any."
  @spec open(Catalog.id(), term(), map()) ::
          {:ok, Catalog.Item.t(), Source.t(), t() | nil} | {:error, Error.t()}
  def open(studio, id, %{"with" => other} = params) when is_binary(other) and other != "" do
    with {:ok, item, {Derived, %{source: first}}} <- Catalog.open(studio, id),
         {:ok, compared, {Derived, %{source: second}}} <- Catalog.open(studio, other),
         {:ok, a} <- Source.call(first, :extent, []),
         {:ok, b} <- Source.call(second, :extent, []) do
      offset =
        case WholeNumber.parse(params["offset"]) do
          {:ok, offset} -> offset
          :error -> a.from - b.from
        end

      told = %__MODULE__{
        id: other,
        title: compared.title,
        offset: offset,
        first: a,
        second: b
      }

      {:ok, item, Derived.wrap(Beside.of(first, second, offset)), told}
    end
  end

  def open(studio, id, _params) do
    with {:ok, item, source} <- Catalog.open(studio, id), do: {:ok, item, source, nil}
  end

  @doc "The same two sources with another shift; a source that compares nothing stays as it is."
  @spec align(Source.t(), Situ.Time.duration()) :: Source.t()
  def align({Derived, %{source: {Beside, beside}}}, offset),
    do: Derived.wrap({Beside, %{beside | offset: offset}})

  def align(source, _offset), do: source

  @doc """
  The layout with each stream of the first beside that of the same name of the second: lines and lanes in one panel,
  pictures and values in panels side by side. The second's streams that the layout shows already are not added
  again. `names` are all streams.

      iex> alias Situ.Studio.{Comparison, Layout}
      iex> {:ok, layout, _} = Layout.add(Layout.new(""), "Level", "line", :plot, "")
      iex> {:ok, layout, _} = Layout.add(layout, "Image", "image", :image, "")
      iex> both = Comparison.layout(layout, ["Level", "Image", "Compared.Level", "Compared.Image"])
      iex> for p <- both.rows, do: {p.panel, Enum.map(p.vis, & &1.stream)}
      [{:image, ["Image"]}, {:image, ["Compared.Image"]}, {:plot, ["Level", "Compared.Level"]}]
  """
  @spec layout(Layout.t(), Enumerable.t()) :: Layout.t()
  def layout(%Layout{} = layout, names) do
    shown =
      for panel <- layout.rows, v <- panel.vis, into: MapSet.new(), do: {v.viz, v.stream, v.path}

    names = MapSet.new(names)
    twins = fn v -> Enum.reject(twin(v, names), &({&1.viz, &1.stream, &1.path} in shown)) end
    {panels, vis} = Layout.limits()

    {rows, next} =
      Enum.flat_map_reduce(layout.rows, layout.next, fn panel, next ->
        case Enum.flat_map(panel.vis, twins) do
          [] ->
            {[panel], next}

          # each beside its own twin
          _ when panel.panel in [:plot, :lanes] ->
            both = Enum.flat_map(panel.vis, &[&1 | twins.(&1)])
            {[%{panel | vis: Enum.take(both, vis)}], next}

          seconds ->
            {[panel, %{panel | id: "p#{next}", vis: seconds}], next + 1}
        end
      end)

    %{layout | rows: Enum.take(rows, panels), next: next}
  end

  defp twin(vis, names) do
    name = Beside.name(vis.stream)

    if name in names,
      do: [%{vis | stream: name, props: Map.delete(vis.props, "color")}],
      else: []
  end
end
