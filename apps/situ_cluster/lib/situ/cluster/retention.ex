defmodule Situ.Cluster.Retention do
  @moduledoc false
  # Lists how much the log contains of each deployment, and deletes it when it is no longer needed. The log of a
  # deployment remains after its end, so that it can still be read. It takes disk space and, on a NATS server, two
  # open files per stream. Nothing is deleted automatically: see `Situ.Cluster.list_log_usage/0` and
  # `Situ.Cluster.prune/2`.
  alias Situ.Cluster.Lease
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @typedoc "The size of one deployment in the log; `written`: ns since 1970, or `nil` if no stream was ever written."
  @type t :: %{
          deployment: String.t(),
          streams: non_neg_integer(),
          entries: non_neg_integer(),
          bytes: non_neg_integer(),
          written: Situ.Time.t() | nil,
          subjects: [Log.subject()]
        }

  # Anybody with access to the log can write a lease that claims to be very long.
  @longest_ms 60_000

  @doc "Lists the deployments that have entries in the log, by name."
  @spec list(Log.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def list(log) do
    with {:ok, usages} <- Log.list_subjects(log) do
      groups = usages |> Enum.group_by(&deployment_name(&1.subject)) |> Map.delete(nil)
      {:ok, for({name, infos} <- Enum.sort(groups), do: summarize_subjects(name, infos))}
    end
  end

  @doc """
  Returns the deployment that a subject belongs to, or `nil` for other subjects.

      iex> Situ.Cluster.Retention.deployment_name({:stream, "Hall.Smooth.Window"})
      "Hall"
      iex> Situ.Cluster.Retention.deployment_name({:key, "lease.Hall.Smooth"})
      "Hall"
      iex> Situ.Cluster.Retention.deployment_name({:key, "settings"})
      nil
  """
  @spec deployment_name(Log.subject()) :: String.t() | nil
  def deployment_name({:stream, name}) do
    with [deployment, _stream] <- String.split(name, ".", parts: 2),
         do: deployment,
         else: (_ -> nil)
  end

  def deployment_name({:key, name}) do
    case String.split(name, ".", parts: 3) do
      [kind, deployment, _part] when kind in ~w(lease state ckpt run) -> deployment
      _ -> nil
    end
  end

  defp summarize_subjects(name, infos) do
    streams = for %{subject: {:stream, _}} = info <- infos, do: info

    %{
      deployment: name,
      streams: length(streams),
      entries: streams |> Enum.map(& &1.entries) |> Enum.sum(),
      bytes: streams |> Enum.map(&(&1.bytes || 0)) |> Enum.sum(),
      written:
        infos |> Enum.map(& &1.written) |> Enum.reject(&is_nil/1) |> Enum.max(fn -> nil end),
      subjects: Enum.map(infos, & &1.subject)
    }
  end

  # Returns the numbers of the leases and of their renewals, and the longest duration of a lease (ms). The numbers
  # change while any node runs a part of the deployment or serves its streams, since the owner's node renews its lease
  # every quarter of that duration.
  defp read_leases(log, usage) do
    keys = for {:key, "lease." <> _} = subject <- usage.subjects, do: subject

    Enum.reduce_while(keys, {:ok, %{}, 0}, fn key, {:ok, seqs, longest} ->
      case Log.fetch_last(log, key) do
        {:ok, nil} ->
          {:cont, {:ok, Map.put(seqs, key, nil), longest}}

        {:ok, entry} ->
          longest = max(longest, Entry.head_integer(entry, "Ms", 0))
          {:cont, {:ok, Map.put(seqs, key, {entry.seq, read_renewal(log, entry)}), longest}}

        {:error, error} ->
          {:halt, {:error, error}}
      end
    end)
  end

  # A node that was restarted since does not renew this lease.
  defp read_renewal(log, entry) do
    with %{key: key, session: session} <- Lease.node_lease(entry),
         {:ok, %Entry{seq: seq, head: %{"Session" => ^session}}} <-
           Log.fetch_last(log, {:key, key}),
         do: seq,
         else: (_ -> nil)
  end

  @doc "Finds a deployment by its name."
  @spec fetch_by_name([t()], String.t()) :: {:ok, t()} | {:error, Error.t()}
  def fetch_by_name(usages, name) do
    case {Enum.find(usages, &(&1.deployment == name)),
          Enum.map_join(usages, ", ", & &1.deployment)} do
      {nil, ""} ->
        {:error,
         Error.new(
           :not_found,
           "the log contains no deployment #{inspect(name)}; it contains none at all"
         )}

      {nil, names} ->
        {:error,
         Error.new(:not_found, "the log contains no deployment #{inspect(name)}",
           fix: "choose from: " <> names
         )}

      {usage, _} ->
        {:ok, usage}
    end
  end

  @doc "Deletes a deployment's log if no node uses it (`check_unused/3`); needs only the log, not a cluster."
  @spec prune(Log.t(), String.t(), non_neg_integer()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def prune(log, name, wait) do
    with {:ok, usages} <- list(log),
         {:ok, usage} <- fetch_by_name(usages, name),
         :ok <- check_unused(log, usage, wait),
         do: delete(log, usage)
  end

  @doc """
  Deletes everything that the log contains of a deployment, and returns the number of subjects. Deletes the streams
  first, so that an interrupted deletion is listed again.
  """
  @spec delete(Log.t(), t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def delete(log, usage) do
    usage.subjects
    |> Enum.sort(:desc)
    |> Enum.reduce_while({:ok, 0}, fn subject, {:ok, n} ->
      case Log.delete(log, subject) do
        :ok -> {:cont, {:ok, n + 1}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc """
  Returns an error if any node uses the deployment, even a node outside of this cluster. Reads the leases
  twice, `wait` ms apart, or half of the longest lease if that is longer.
  """
  @spec check_unused(Log.t(), t(), non_neg_integer()) :: :ok | {:error, Error.t()}
  def check_unused(log, usage, wait) do
    with {:ok, before, longest} <- read_leases(log, usage),
         :ok <- wait_ms(max(wait, min(div(longest, 2), @longest_ms))),
         {:ok, ^before, _} <- read_leases(log, usage) do
      :ok
    else
      {:ok, _changed, _} -> {:error, in_use_error(usage.deployment)}
      {:error, error} -> {:error, error}
    end
  end

  defp wait_ms(ms) do
    receive do
    after
      ms -> :ok
    end
  end

  @doc false
  @spec in_use_error(String.t()) :: Error.t()
  def in_use_error(name) do
    Error.new(:in_use, "#{name} is in use, so its log was not deleted",
      why: "a node is running a part of it, and would continue to write to the log",
      fix: "stop the deployment and wait for its end, or remove it with Situ.Cluster.forget/1"
    )
  end
end
