defmodule Situ.Cluster.Deployments do
  @moduledoc false
  # Keeps the deployments of a cluster in one key of its log, so that the nodes can run them again after all of them
  # were lost. Each deployment has a run, a random name that is part of the key of its seals. When a log was deleted
  # and another deployment gets the same name, nodes refuse all entries of the earlier one. A forgotten deployment
  # keeps its run as long as its log exists, and continues from its last position when it is deployed again. The log
  # of a run contains a mark, which disappears with it, even if the program that deletes the log does not have the
  # cookie.
  alias Situ.Cluster.{Deployment, SignedEntry, SealedLog}
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @tries 100

  @typedoc "The deployments by name; `deployment` is `nil` when it was forgotten."
  @type entries :: %{String.t() => %{run: String.t(), deployment: Deployment.t() | nil}}

  @doc """
  Stores a deployment and assigns its run. A deployment that is already stored under the same name must be equal to it.

  After an error with the code `:log_away`, call the function again to complete the operation.
  """
  @spec put(Log.t(), Deployment.t()) :: {:ok, Deployment.t()} | {:error, Error.t()}
  def put(log, %Deployment{} = deployment) do
    with {:ok, deployment} <- put_deployment(log, deployment),
         :ok <- put_mark(log, deployment),
         do: {:ok, deployment}
  end

  defp put_deployment(log, %{name: name} = deployment) do
    update_entries(log, fn entries ->
      with :ok <- check_same(entries[name], deployment),
           {:ok, run} <- choose_run(log, name, entries[name]) do
        deployment = %{deployment | run: run}
        {:ok, Map.put(entries, name, %{run: run, deployment: deployment}), deployment}
      end
    end)
  end

  defp check_same(%{run: run, deployment: %Deployment{} = other}, deployment) do
    if other == %{deployment | run: run},
      do: :ok,
      else: {:error, duplicate_error(deployment.name)}
  end

  defp check_same(_unknown_or_forgotten, _deployment), do: :ok

  # The deployment keeps its previous run as long as the log of that run exists.
  defp choose_run(_log, _name, nil), do: {:ok, new_run()}

  defp choose_run(log, name, %{run: run}) do
    with {:ok, exists?} <- find_log(log, name, run),
         do: {:ok, if(exists?, do: run, else: new_run())}
  end

  defp put_mark(log, %{name: name, run: run}) do
    case Log.append(SealedLog.new(log, run), mark_key(name), 0, %Entry{op: "deployed"}) do
      {:error, error} -> {:error, error}
      _written_or_refused -> :ok
    end
  end

  defp mark_key(name), do: {:key, "run.#{name}.deployed"}

  @doc "Returns whether the log of a run exists. It may have been deleted while no node was running."
  @spec find_log(Log.t(), String.t(), String.t()) :: {:ok, boolean()} | {:error, Error.t()}
  def find_log(log, name, run) do
    with {:ok, mark} <- Log.fetch_last(SealedLog.new(log, run), mark_key(name)),
         do: {:ok, mark != nil}
  end

  defp new_run, do: Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)

  @doc "Marks a deployment as no longer to be run; its log remains."
  @spec forget(Log.t(), String.t()) :: :ok | {:error, Error.t()}
  def forget(log, name) do
    change_entries(log, fn entries ->
      if entries[name], do: put_in(entries[name].deployment, nil), else: entries
    end)
  end

  @doc "Removes a deployment whose log was deleted."
  @spec delete(Log.t(), String.t()) :: :ok | {:error, Error.t()}
  def delete(log, name), do: change_entries(log, &Map.delete(&1, name))

  @doc "Returns the deployments that should be running."
  @spec list_active(Log.t()) :: {:ok, [Deployment.t()]} | {:error, Error.t()}
  def list_active(log) do
    with {:ok, entries, _seq} <- read_entries(seal_log(log)),
         do: {:ok, for({_, %{deployment: %Deployment{} = d}} <- Enum.sort(entries), do: d)}
  end

  @doc "Returns the error for a second deployment with the same name."
  @spec duplicate_error(String.t()) :: Error.t()
  def duplicate_error(name) do
    Error.new(:duplicate_name, "there is already a deployment #{inspect(name)}",
      fix:
        "give this one another name:, or stop and forget that one (situ cluster stop NAME --forget)"
    )
  end

  defp change_entries(log, change) do
    with {:ok, :ok} <- update_entries(log, fn entries -> {:ok, change.(entries), :ok} end),
         do: :ok
  end

  defp update_entries(log, change), do: update_entries(seal_log(log), change, @tries)

  defp update_entries(log, change, tries) do
    with {:ok, entries, seq} <- read_entries(log), {:ok, updated, result} <- change.(entries) do
      if updated == entries,
        do: {:ok, result},
        else: write_entries(log, {updated, seq, result}, change, tries)
    end
  end

  defp write_entries(log, {updated, seq, result}, change, tries) do
    nonce = Base.encode16(:crypto.strong_rand_bytes(6), case: :lower)
    entry = %Entry{op: "deployments.#{nonce}", data: SignedEntry.encode_term(updated)}

    case Log.append(log, log_subject(), seq, entry) do
      {:ok, _seq} -> {:ok, result}
      {:refused, _} when tries > 0 -> update_entries(log, change, tries - 1)
      {:refused, _} -> {:error, Error.new(:log_away, "the list of deployments is being written")}
      {:error, error} -> {:error, error}
    end
  end

  defp read_entries(log) do
    case Log.fetch_last(log, log_subject()) do
      {:ok, nil} ->
        {:ok, %{}, 0}

      {:ok, entry} ->
        with {:ok, entries} <- SignedEntry.decode_term(entry), do: {:ok, entries, entry.seq}

      {:error, error} ->
        {:error, error}
    end
  end

  # Two clusters with different cookies may share a log.
  defp log_subject, do: {:key, "deployments." <> SignedEntry.cluster_name()}
  defp seal_log(log), do: SealedLog.new(log, "")
end
