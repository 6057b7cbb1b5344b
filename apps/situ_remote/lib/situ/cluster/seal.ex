defmodule Situ.Cluster.Seal do
  @moduledoc false
  # Signs whole entries of the log, and checks them: subject, place, name, head and data together. The key comes from
  # the cluster's cookie and from the run of a deployment (`Situ.Cluster.Deployments`). So nobody without the cookie can
  # write an entry that is believed, and an entry is believed nowhere but where it was written: not on another subject,
  # not at another place of the same one, and not by a later run that has the same name.
  #
  #   Follows   the number of the entry that it was written behind        Seal   nonce and MAC, in Base64
  #
  # Whoever may delete entries can still take the whole log back to an earlier state: a seal says who wrote an entry,
  # not that nothing came after it.
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @seal "Seal"
  @follows "Follows"

  @doc "The entry as it is written behind number `follows` of a subject."
  @spec close(Entry.t(), String.t(), Log.subject(), non_neg_integer()) :: Entry.t()
  def close(%Entry{} = entry, run, subject, follows) do
    key = key(run)

    # The log takes an entry of the same name for the same write, so nobody else may guess the name of the next one.
    mark = :crypto.mac(:hmac, :sha256, key, context(subject, follows, entry.op, []))
    op = entry.op <> "." <> Base.encode16(binary_part(mark, 0, 8), case: :lower)
    head = entry.head |> Map.delete(@seal) |> Map.put(@follows, Integer.to_string(follows))
    nonce = :crypto.strong_rand_bytes(16)
    mac = mac(key, nonce, context(subject, follows, op, head), entry.data)
    %{entry | op: op, head: Map.put(head, @seal, Base.encode64(nonce <> mac)), verified: false}
  end

  @doc """
  Checks an entry that was read: who wrote it, and that it is where it was written. Of a key the entry before may be
  gone, and its place cannot be told from the entry alone: `:behind` says what must be the entry before it.
  """
  @spec open(Entry.t(), String.t(), Log.subject()) ::
          {:ok, Entry.t()} | {:behind, non_neg_integer(), Entry.t()} | {:error, Error.t()}
  def open(%Entry{head: head} = entry, run, subject) do
    with {:ok, nonce, mac} <- sealed(head),
         follows when is_integer(follows) <- Entry.integer(entry, @follows, nil),
         signed = Map.delete(head, @seal),
         true <-
           fits?(
             mac,
             mac(key(run), nonce, context(subject, follows, entry.op, signed), entry.data)
           ) do
      place(%{entry | head: Map.delete(signed, @follows), verified: true}, subject, follows)
    else
      :unsealed -> {:error, unsealed(entry, subject)}
      _ -> {:error, forged(entry, subject)}
    end
  end

  defp place(%{seq: seq} = entry, _subject, follows) when seq == follows + 1, do: {:ok, entry}

  defp place(%{seq: seq} = entry, {:key, _}, follows) when seq > follows,
    do: {:behind, follows, entry}

  defp place(entry, subject, _follows), do: {:error, moved(entry, subject)}

  defp sealed(%{@seal => text}) do
    with {:ok, <<nonce::binary-16, mac::binary-16>>} <- Base.decode64(text),
         do: {:ok, nonce, mac},
         else: (_ -> :error)
  end

  defp sealed(_head), do: :unsealed

  defp fits?(mac, own), do: :crypto.hash_equals(mac, own)

  @doc "A term for the data of an entry. A picture is nowhere copied on its way."
  @spec encode_term(term()) :: iodata()
  def encode_term(term), do: :erlang.term_to_iovec(term)

  @doc "The term in an entry whose seal was checked; no other entry is decoded."
  @spec decode_term(Entry.t()) :: {:ok, term()} | {:error, Error.t()}
  def decode_term(%Entry{verified: true, data: data}),
    do: {:ok, data |> IO.iodata_to_binary() |> :erlang.binary_to_term()}

  def decode_term(%Entry{} = entry), do: {:error, forged(entry, nil)}

  @doc "Whether an error says that an entry is not to be believed."
  @spec refusal?(term()) :: boolean()
  def refusal?(%Error{code: code}), do: code in [:forged_entry, :unsealed_entry]
  def refusal?(_other), do: false

  @doc "The error of an entry that was written elsewhere in the log, or earlier."
  @spec moved(Entry.t(), Log.subject()) :: Error.t()
  def moved(entry, subject) do
    Error.new(:forged_entry, "#{name(entry, subject)} is not where it was written",
      why: "somebody has copied it, written it once more, or taken away entries before it",
      fix: fix(),
      meta: %{seq: entry.seq}
    )
  end

  defp forged(entry, subject) do
    Error.new(:forged_entry, "#{name(entry, subject)} does not bear the seal of this deployment",
      why:
        "it was changed, or written by somebody else, by a cluster with another cookie, or by an earlier run",
      fix: fix(),
      meta: %{seq: entry.seq}
    )
  end

  defp unsealed(entry, subject) do
    Error.new(:unsealed_entry, "#{name(entry, subject)} has no seal",
      why:
        "it was written by an older version of Situ, which did not sign whole entries, or by somebody else",
      fix:
        "delete what that version has left (`situ cluster prune NAME --log ADDRESS`), or give the cluster another log",
      meta: %{seq: entry.seq}
    )
  end

  defp fix,
    do:
      "keep others from the log (`situ cluster init` makes credentials), then delete this deployment's entries" <>
        " (`situ cluster prune`) and deploy it again"

  defp name(entry, nil), do: "entry #{entry.seq}"
  defp name(entry, {kind, name}), do: "entry #{entry.seq} of the #{kind} #{name}"

  # All that is signed beside the data, so that no two entries give the same bytes.
  defp context({kind, name}, follows, op, head) do
    :erlang.term_to_binary({Atom.to_string(kind), name, follows, op, Enum.sort(head)},
      minor_version: 2
    )
  end

  # Poly1305 under a key that is used once: a seventh of what HMAC costs for a picture.
  defp mac(key, nonce, context, data) do
    state = :crypto.mac_init(:poly1305, :crypto.mac(:hmac, :sha256, key, nonce))
    state = :crypto.mac_update(state, [<<byte_size(context)::64>>, context])
    :crypto.mac_final(update(data, state))
  end

  defp update(data, state) when is_binary(data), do: :crypto.mac_update(state, data)

  defp update(data, state),
    do: data |> :erlang.iolist_to_iovec() |> Enum.reduce(state, &:crypto.mac_update(&2, &1))

  # Made anew each time, so that no process and no crash report holds it.
  defp key(run) do
    cookie = :crypto.hash(:sha256, ["situ log 2 ", Atom.to_string(Node.get_cookie())])
    :crypto.mac(:hmac, :sha256, cookie, run)
  end

  @doc "A name for this cluster that does not tell its cookie."
  @spec cluster() :: String.t()
  def cluster,
    do: "name" |> key() |> binary_part(0, 8) |> Base.encode16(case: :lower)
end
