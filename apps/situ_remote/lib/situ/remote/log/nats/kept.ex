defmodule Situ.Remote.Log.Nats.Kept do
  @moduledoc false
  # Lists and deletes the JetStream streams and keys that belong to a log.
  alias Situ.{Error, JSON}
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Nats
  alias Situ.Remote.Log.Nats.Api

  @doc "Lists the streams whose JetStream names begin with `prefix`, and the keys in the JetStream stream `keys`."
  @spec all(Nats.t(), String.t(), String.t()) :: {:ok, [Log.about()]} | {:error, Error.t()}
  def all(log, prefix, keys) do
    with {:ok, streams} <- streams(log, prefix, 0, []),
         {:ok, of_keys} <- keys(log, keys, 0, []),
         do: {:ok, streams ++ of_keys}
  end

  # The server returns the list in pages.
  defp streams(log, prefix, offset, found) do
    body = JSON.encode(%{"offset" => offset, "subject" => "situ.s.>"})

    case Api.ask(log, log.api <> "STREAM.LIST", body, 10_000) do
      {:ok, %{"streams" => page, "total" => total}} when is_list(page) and page != [] ->
        found = found ++ for(info <- page, about <- stream(info, prefix), do: about)
        next = offset + length(page)
        if next < total, do: streams(log, prefix, next, found), else: {:ok, found}

      {:ok, %{"error" => error}} ->
        {:error, Api.refusal(error)}

      {:ok, _empty} ->
        {:ok, found}

      {:error, error} ->
        {:error, error}
    end
  end

  defp stream(%{"config" => %{"name" => name, "subjects" => [subject]}, "state" => state}, prefix) do
    with true <- String.starts_with?(name, prefix), "situ.s." <> token <- subject do
      entries = state["messages"] || 0
      # For a stream that never had an entry, the server returns a meaningless time.
      written = if (state["last_seq"] || 0) > 0, do: time(state["last_ts"])
      subject = {:stream, URI.decode(token)}
      [%{subject: subject, entries: entries, bytes: state["bytes"], written: written}]
    else
      _ -> []
    end
  end

  defp stream(_another, _prefix), do: []

  defp time(text) do
    with true <- is_binary(text), {:ok, at, _offset} <- DateTime.from_iso8601(text) do
      DateTime.to_unix(at, :nanosecond)
    else
      _ -> nil
    end
  end

  defp keys(log, keys, offset, found) do
    body = JSON.encode(%{"subjects_filter" => "situ.k.>", "offset" => offset})

    case Api.ask(log, log.api <> "STREAM.INFO." <> keys, body, 10_000) do
      {:ok, %{"state" => %{"subjects" => page}} = info} when map_size(page) > 0 ->
        found = found ++ for({"situ.k." <> token, n} <- page, do: key(token, n))
        next = offset + map_size(page)
        if next < (info["total"] || 0), do: keys(log, keys, next, found), else: {:ok, found}

      {:ok, %{"error" => error}} ->
        {:error, Api.refusal(error)}

      {:ok, _empty} ->
        {:ok, found}

      {:error, error} ->
        {:error, error}
    end
  end

  # Only the last entry of a key counts.
  defp key(token, n),
    do: %{subject: {:key, URI.decode(token)}, entries: min(n, 1), bytes: nil, written: nil}

  @doc "Deletes a JetStream stream and its files."
  @spec delete(Nats.t(), String.t()) :: :ok | {:error, Error.t()}
  def delete(log, stream),
    do: log |> Api.ask(log.api <> "STREAM.DELETE." <> stream, "", 10_000) |> done()

  @doc "Deletes all messages of a subject."
  @spec purge(Nats.t(), String.t(), String.t()) :: :ok | {:error, Error.t()}
  def purge(log, stream, subject) do
    body = JSON.encode(%{"filter" => subject})
    log |> Api.ask(log.api <> "STREAM.PURGE." <> stream, body, 10_000) |> done()
  end

  defp done({:ok, %{"success" => true}}), do: :ok
  defp done({:ok, %{"error" => %{"err_code" => 10_059}}}), do: :ok
  defp done({:ok, %{"error" => error}}), do: {:error, Api.refusal(error)}
  defp done({:ok, _other}), do: {:error, Api.away("the reply is incomplete")}
  defp done({:error, error}), do: {:error, error}
end
