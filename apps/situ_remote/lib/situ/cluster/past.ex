defmodule Situ.Cluster.Past do
  @moduledoc """
  Lists how much the log keeps of each deployment, and deletes it when nobody needs it any more.

  The log of a deployment stays when it has ended: whoever wants may read it. It costs room, and on a NATS server two
  open files a stream. Nothing is deleted without being asked for:

      {:ok, log} = Situ.Remote.Log.connect("nats://lab1:4222")
      {:ok, kept} = Situ.Cluster.Past.list(log)
      {:ok, 12} = Situ.Cluster.Past.delete(log, hd(kept))

  `Situ.Cluster.kept/0` and `Situ.Cluster.prune/2` do this for the log of a cluster, `bin/situ cluster kept` and
  `bin/situ cluster prune` from a shell.
  """
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @typedoc "How much one deployment has in the log; `written`: ns since 1970, `nil` when no stream was ever written to."
  @type t :: %{
          deployment: String.t(),
          streams: non_neg_integer(),
          entries: non_neg_integer(),
          bytes: non_neg_integer(),
          written: Situ.Time.t() | nil,
          subjects: [Log.subject()]
        }

  # Anybody who reaches the log can write a lease that claims to be very long.
  @longest_ms 60_000

  @doc "Lists each deployment that has something in the log, by name."
  @spec list(Log.t()) :: {:ok, [t()]} | {:error, Error.t()}
  def list(log) do
    with {:ok, all} <- Log.subjects(log) do
      groups = all |> Enum.group_by(&deployment(&1.subject)) |> Map.delete(nil)
      {:ok, for({name, abouts} <- Enum.sort(groups), do: summary(name, abouts))}
    end
  end

  @doc """
  The deployment that a subject belongs to; `nil`: none.

      iex> Situ.Cluster.Past.deployment({:stream, "Hall.Smooth.Window"})
      "Hall"
      iex> Situ.Cluster.Past.deployment({:key, "lease.Hall.Smooth"})
      "Hall"
      iex> Situ.Cluster.Past.deployment({:key, "settings"})
      nil
  """
  @spec deployment(Log.subject()) :: String.t() | nil
  def deployment({:stream, name}) do
    with [deployment, _stream] <- String.split(name, ".", parts: 2),
         do: deployment,
         else: (_ -> nil)
  end

  def deployment({:key, name}) do
    case String.split(name, ".", parts: 3) do
      [kind, deployment, _part] when kind in ~w(lease state ckpt run) -> deployment
      _ -> nil
    end
  end

  defp summary(name, abouts) do
    streams = for %{subject: {:stream, _}} = about <- abouts, do: about

    %{
      deployment: name,
      streams: length(streams),
      entries: streams |> Enum.map(& &1.entries) |> Enum.sum(),
      bytes: streams |> Enum.map(&(&1.bytes || 0)) |> Enum.sum(),
      written:
        abouts |> Enum.map(& &1.written) |> Enum.reject(&is_nil/1) |> Enum.max(fn -> nil end),
      subjects: Enum.map(abouts, & &1.subject)
    }
  end

  # The numbers of the leases change while any node runs a part of it, or serves its streams. How long the longest is,
  # ms: its owner writes it every quarter of that.
  defp leases(log, kept) do
    keys = for {:key, "lease." <> _} = subject <- kept.subjects, do: subject

    Enum.reduce_while(keys, {:ok, %{}, 0}, fn key, {:ok, seqs, longest} ->
      case Log.last(log, key) do
        {:ok, entry} ->
          longest = max(longest, Entry.integer(entry, "Ms", 0))
          {:cont, {:ok, Map.put(seqs, key, entry && entry.seq), longest}}

        {:error, error} ->
          {:halt, {:error, error}}
      end
    end)
  end

  @doc "Finds one by its name."
  @spec find([t()], String.t()) :: {:ok, t()} | {:error, Error.t()}
  def find(all, name) do
    case {Enum.find(all, &(&1.deployment == name)), Enum.map_join(all, ", ", & &1.deployment)} do
      {nil, ""} ->
        {:error,
         Error.new(:not_found, "the log keeps nothing of #{inspect(name)}, or of anything")}

      {nil, names} ->
        {:error,
         Error.new(:not_found, "the log keeps nothing of #{inspect(name)}",
           fix: "it keeps something of: " <> names
         )}

      {kept, _} ->
        {:ok, kept}
    end
  end

  @doc "Deletes all of a deployment that nobody uses (`unused/3`), by the log alone."
  @spec prune(Log.t(), String.t(), non_neg_integer()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def prune(log, name, wait) do
    with {:ok, all} <- list(log),
         {:ok, kept} <- find(all, name),
         :ok <- unused(log, kept, wait),
         do: delete(log, kept)
  end

  @doc """
  Deletes all that the log keeps of a deployment: the number of subjects. Streams first, so that one that was
  interrupted is listed again.
  """
  @spec delete(Log.t(), t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def delete(log, kept) do
    kept.subjects
    |> Enum.sort(:desc)
    |> Enum.reduce_while({:ok, 0}, fn subject, {:ok, n} ->
      case Log.delete(log, subject) do
        :ok -> {:cont, {:ok, n + 1}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc """
  Refuses what is in use by nodes that nobody here knows of: looks at the leases twice, `wait` ms apart or half of the
  longest lease, whichever is more.
  """
  @spec unused(Log.t(), t(), non_neg_integer()) :: :ok | {:error, Error.t()}
  def unused(log, kept, wait) do
    with {:ok, before, longest} <- leases(log, kept),
         :ok <- pause(max(wait, min(div(longest, 2), @longest_ms))),
         {:ok, ^before, _} <- leases(log, kept) do
      :ok
    else
      {:ok, _changed, _} -> {:error, in_use(kept.deployment)}
      {:error, error} -> {:error, error}
    end
  end

  defp pause(ms) do
    receive do
    after
      ms -> :ok
    end
  end

  @doc false
  @spec in_use(String.t()) :: Error.t()
  def in_use(name) do
    Error.new(:in_use, "#{name} is in use: its log stays",
      why: "a node has a part of it, and would write on",
      fix: "stop the deployment and wait for its end, or take it away with Situ.Cluster.forget/1"
    )
  end
end
