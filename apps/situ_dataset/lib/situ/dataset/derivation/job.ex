defmodule Situ.Dataset.Derivation.Job do
  @moduledoc false
  # Describes one session of a run: the computation and the path of its output. It runs in a separate process on any
  # node.
  alias Situ.Dataset.{Importer, OpenSession, Partition, Session, StoredPath, StoreVersion}
  alias Situ.{Error, Pipeline, Store}

  @enforce_keys [:session, :compute]
  defstruct [:session, :compute, :output, :path, :draft, :provenance, options: [], settings: []]

  @type compute :: module() | (Pipeline.t(), Importer.t(), Store.Exporter.t() | nil -> term())
  @type t :: %__MODULE__{}

  @spec new(Session.t(), compute(), keyword()) :: t()
  def new(session, compute, opts) do
    path = opts[:output] && output_path(session, opts)

    %__MODULE__{
      session: session,
      compute: compute,
      output: opts[:output],
      path: path,
      draft: path && StoreVersion.draft_path(path),
      provenance: opts[:provenance] && opts[:provenance].(session),
      options: opts[:options],
      settings: Keyword.put_new(opts[:pipeline], :replay, speed: :max)
    }
  end

  defp output_path(session, opts) do
    folder =
      case opts[:path] do
        nil -> session_folder(session.partitions)
        fun when is_function(fun) -> fun.(session)
        path -> Path.join(path, session.name)
      end

    Path.join(Path.expand(folder), opts[:store] || opts[:output])
  end

  defp session_folder([%Partition{path: path} | rest]),
    do: if(StoredPath.windows_path?(path), do: session_folder(rest), else: Path.dirname(path))

  defp session_folder([]), do: "."

  @doc "Builds the partition of an output. The provenance is an additional field of the dataset file."
  @spec build_partition(String.t(), Path.t(), map() | nil) :: Partition.t()
  def build_partition(output, folder, nil), do: Partition.new(output, folder)

  def build_partition(output, folder, provenance),
    do: %{Partition.new(output, folder) | extra: %{"provenance" => provenance}}

  @doc "Runs the session in the calling process: sends its pipeline to the coordinator and exits with the result."
  @spec run(t(), pid()) :: no_return()
  def run(%__MODULE__{} = job, coordinator) do
    me = self()

    result =
      Pipeline.run(
        fn p ->
          send(coordinator, {:pipeline, me, p})
          build_pipeline(p, job)
        end,
        pipeline: job.settings
      )

    case result do
      {:ok, report} -> exit({:shutdown, {:done, report.result}})
      {:error, error} -> exit({:shutdown, {:failed, error}})
    end
  end

  defp build_pipeline(p, job) do
    importer = Importer.open(p, job.session)
    require_stores!(importer.session)
    exporter = job.draft && Store.create(p, Path.basename(job.path), job.draft, versioned: false)
    call_compute(job.compute, p, importer, exporter, job)
  end

  # Without any readable recording, an empty output would look like a valid result.
  defp require_stores!(%{stores: [], troubles: [{_, error} | _]}), do: raise(error)
  defp require_stores!(_), do: :ok

  defp call_compute(fun, p, importer, exporter, _job) when is_function(fun, 3),
    do: fun.(p, importer, exporter)

  # These options do not refer to modules of this application, so that tasks may be in applications below it.
  defp call_compute(module, p, importer, exporter, job) when is_atom(module) do
    session_opts = [
      pipeline: p,
      importer: importer,
      exporter: exporter,
      session: job.session,
      open: &Importer.stream(importer, &1),
      has: &Importer.has_stream?(importer, &1),
      write: &Store.write(&1, exporter, &2),
      # The partition of an earlier run will be replaced, so it is not an input.
      streams:
        for(
          {name, _} = stream <- OpenSession.list_streams(importer.session),
          name != job.output,
          do: stream
        ),
      folder: session_folder(job.session.partitions)
    ]

    module.build(p, session_opts ++ job.options)
  end

  @doc "Gives the output its final name."
  @spec publish_output(t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def publish_output(%__MODULE__{} = job), do: StoreVersion.publish_draft(job.draft, job.path)

  @doc "Deletes the output of a session that failed or was cancelled."
  @spec discard_output(t()) :: :ok
  def discard_output(%__MODULE__{draft: nil}), do: :ok
  def discard_output(%__MODULE__{draft: draft}), do: StoreVersion.discard_draft(draft)
end
