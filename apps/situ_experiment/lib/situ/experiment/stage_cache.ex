defmodule Situ.Experiment.StageCache do
  @moduledoc false
  # Stages of an experiment that many sets of parameters share. A stage is computed by its own pipeline, before the
  # pipeline that needs it, and recorded. A lock on its key prevents two results from computing it at the same time.
  alias Situ.Dataset.StoreVersion
  alias Situ.Experiment.{BusyTime, CodeVersion, Context, FileTransfer, Input, ResultsFile}
  alias Situ.{Error, Pipeline, Store}

  @store "Stage"

  @doc "Returns the streams of a stage in the pipeline of `input`, after computing it if necessary."
  @spec open_streams(Input.t(), atom() | {module(), atom()}, keyword()) :: %{
          atom() => Situ.Stream.t()
        }
  def open_streams(%Input{context: context} = input, stage, options) do
    {module, function} = stage_function(stage, context)
    options = Map.new(options)
    folder = stage_folder(input, {module, function}, options)

    if read_manifest(folder) == :error do
      lock_stage(context, folder, fn ->
        ensure_stage(input, {module, function}, options, folder)
      end)
    end

    {:ok, manifest, path} = read_manifest(folder)
    if context.owner, do: send(context.owner, {:stage_used, self(), folder, manifest["busy_s"]})
    importer = Store.importer(input.pipeline, path)
    exported = for name <- manifest["streams"], do: {String.to_existing_atom(name), name}
    Map.new(exported, fn {key, name} -> {key, Store.stream(importer, name)} end)
  end

  defp ensure_stage(%{context: context} = input, stage, options, folder) do
    if read_manifest(folder) == :error and not fetch_stage(context, folder) do
      compute_stage(input, stage, options, folder)
      offer_stage(context, folder)
    end
  end

  # On a node of a cluster, the node that started the run has the lock and the stages of all nodes.
  defp lock_stage(%{peer: nil}, folder, fun), do: lock_on(node(), folder, fun)

  defp lock_stage(%{peer: peer} = context, folder, fun),
    do: lock_on(peer.node, peer_folder(context, folder), fun)

  defp lock_on(node, folder, fun),
    do: :global.trans({{__MODULE__, folder}, self()}, fun, [node])

  defp peer_folder(%{peer: peer} = context, folder),
    do: Path.join(peer.folder, Path.relative_to(folder, context.folder))

  defp fetch_stage(%{peer: nil}, _folder), do: false

  defp fetch_stage(%{peer: peer} = context, folder) do
    source = peer_folder(context, folder)
    complete? = :erpc.call(peer.node, __MODULE__, :complete_stage?, [source])
    if complete?, do: Error.unwrap!(FileTransfer.fetch_folder(peer.node, source, folder))
    complete?
  end

  defp offer_stage(%{peer: nil}, _folder), do: :ok

  defp offer_stage(%{peer: peer} = context, folder) do
    arguments = [node(), folder, peer_folder(context, folder)]
    Error.unwrap!(:erpc.call(peer.node, __MODULE__, :take_stage, arguments))
  end

  @doc "Returns whether the folder of a stage is complete."
  @spec complete_stage?(Path.t()) :: boolean()
  def complete_stage?(folder), do: read_manifest(folder) != :error

  @doc "Copies a stage from a node that has computed it and holds its lock."
  @spec take_stage(node(), source :: Path.t(), target :: Path.t()) :: :ok | {:error, Error.t()}
  def take_stage(node, source, target) do
    draft = StoreVersion.draft_path(target)

    with :ok <- FileTransfer.fetch_folder(node, source, draft),
         {:ok, _} <- File.rm_rf(target),
         :ok <- File.rename(draft, target) do
      :ok
    else
      {:error, %Error{} = error} ->
        StoreVersion.discard_draft(draft)
        {:error, error}

      other ->
        StoreVersion.discard_draft(draft)
        {:error, Error.new(:not_saved, "cannot save the stage #{target}", why: inspect(other))}
    end
  end

  defp stage_function({module, function}, _context), do: check_function(module, function)
  defp stage_function(function, context), do: check_function(context.module, function)

  defp check_function(module, function) do
    Code.ensure_loaded(module)

    if function_exported?(module, function, 2) do
      {module, function}
    else
      raise Error.new(:no_stage, "the stage #{inspect(module)}.#{function}/2 does not exist",
              fix: "define it as a public function of the session and its options"
            )
    end
  end

  defp stage_folder(input, {module, function}, options) do
    code = CodeVersion.hash_function(input.context.code, module, function)
    speed = Context.speed(input.context)
    values = CodeVersion.hash_values(input.context.code, options)
    key = CodeVersion.hash_term({code, values, input.stamp, speed})
    Path.join([input.context.folder, "stages", "#{function}-#{String.slice(key, 0, 20)}"])
  end

  # The manifest is written last, so a stage with a manifest is complete.
  defp read_manifest(folder) do
    with {:ok, manifest} <- ResultsFile.read_json(Path.join(folder, "stage.json")),
         path when path != nil <- Store.newest(@store, folder) do
      {:ok, manifest, path}
    else
      _ -> :error
    end
  end

  defp compute_stage(input, {module, function}, options, folder) do
    context = input.context
    path = Path.join(folder, @store)
    draft = StoreVersion.draft_path(path)

    build = fn p ->
      streams =
        check_streams(apply(module, function, [%{input | pipeline: p}, options]), function)

      exporter = Store.create(p, @store, draft, versioned: false)
      for {name, stream} <- streams, do: Store.write(stream, exporter, to_string(name))
      for {name, _} <- streams, do: to_string(name)
    end

    with {:ok, report} <- Pipeline.run(build, pipeline: Context.pipeline_settings(context)),
         {:ok, _} <- StoreVersion.publish_draft(draft, path),
         manifest = %{streams: report.result, busy_s: BusyTime.total_seconds(report.snapshot)},
         :ok <- ResultsFile.write_json(Path.join(folder, "stage.json"), manifest) do
      :ok
    else
      {:error, error} ->
        StoreVersion.discard_draft(draft)
        raise error
    end
  end

  defp check_streams(%{} = streams, function) when map_size(streams) > 0 do
    for {name, stream} <- streams, not (is_atom(name) and is_struct(stream, Situ.Stream)) do
      raise stage_error(function, {name, stream})
    end

    streams
  end

  defp check_streams(other, function), do: raise(stage_error(function, other))

  defp stage_error(function, other) do
    Error.new(:bad_stage, "stage #{function} returned #{inspect(other, limit: 3)}",
      fix: "return a map of streams with atoms as keys: %{mouths: mouths, voice: voice}"
    )
  end
end
