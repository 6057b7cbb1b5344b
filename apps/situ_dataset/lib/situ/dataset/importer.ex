defmodule Situ.Dataset.Importer do
  @moduledoc """
  Opens all recordings of a session as one importer of a pipeline.

      Situ.Pipeline.run(fn p ->
        importer = Situ.Dataset.Importer.open(p, session)
        Situ.Dataset.Importer.stream(importer, "[Room]:Loudness") |> Situ.each(&IO.inspect/1)
      end)

  Stream names are resolved as in `Situ.Dataset.OpenSession`; each stream has its own reader. Partitions that cannot
  be opened are skipped and listed in `importer.session.troubles`; requesting a stream of such a partition raises
  its error.
  """
  alias Situ.Dataset.{OpenSession, Session}
  alias Situ.{Error, Pipeline, Store}

  @enforce_keys [:pipeline, :session, :importers]
  defstruct [:pipeline, :session, :importers]

  @type t :: %__MODULE__{
          pipeline: Pipeline.t(),
          session: OpenSession.t(),
          importers: %{String.t() => Store.Importer.t()}
        }

  @doc """
  Opens the session while the pipeline is built, or takes one that is already open. Takes the options of
  `Situ.Store.importer/3`.
  """
  @spec open(Pipeline.t(), Session.t() | OpenSession.t(), keyword()) :: t()
  def open(p, session, opts \\ [])

  def open(%Situ.Graph.Handle{} = p, %Session{} = session, opts),
    do: open(p, OpenSession.open(session, Keyword.take(opts, [:verify])), opts)

  def open(%Situ.Graph.Handle{} = p, %OpenSession{} = open, opts) do
    importers = Map.new(open.stores, fn {name, s} -> {name, Store.importer(p, s, opts)} end)
    %__MODULE__{pipeline: p, session: open, importers: importers}
  end

  @doc """
  Returns a stream of the session, `"Stream"` or `"[Partition]:Stream"`. Takes the options of `Situ.Store.stream/3`.
  With `or_empty: true`, a stream that no partition has becomes a stream without messages; an ambiguous name still
  raises.
  """
  @spec stream(t(), String.t(), keyword()) :: Situ.Stream.t()
  def stream(%__MODULE__{} = importer, spec, opts \\ []) do
    case OpenSession.fetch_stream(importer.session, spec) do
      {:ok, {partition, _, name}} ->
        Store.stream(Map.fetch!(importer.importers, partition), name, opts)

      {:error, %Error{code: code} = error} ->
        if opts[:or_empty] && code in [:no_stream, :no_partition],
          do: empty_stream(importer, spec, opts),
          else: raise(error)
    end
  end

  defp empty_stream(%{importers: importers} = importer, spec, opts) do
    case Map.values(importers) do
      [some | _] -> Store.stream(some, spec, opts)
      [] -> Situ.from_enumerable(importer.pipeline, [], name: spec)
    end
  end

  @doc "Returns whether a name refers to exactly one stream."
  @spec has_stream?(t(), String.t()) :: boolean()
  def has_stream?(%__MODULE__{} = importer, spec),
    do: OpenSession.has_stream?(importer.session, spec)

  @doc "Returns the importer of one partition. Errors: `:no_partition`, or the error of opening the partition."
  @spec partition_importer(t(), String.t()) :: {:ok, Store.Importer.t()} | {:error, Error.t()}
  def partition_importer(%__MODULE__{} = importer, name) do
    with {:ok, _} <- OpenSession.fetch_store(importer.session, name),
         do: Map.fetch(importer.importers, name)
  end
end
