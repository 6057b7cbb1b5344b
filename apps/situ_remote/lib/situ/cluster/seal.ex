defmodule Situ.Cluster.Seal do
  @moduledoc false
  # Signs whole entries of the log, and checks them: subject, position, name, head and data together. The key comes from
  # the cluster's cookie and from the run of a deployment (`Situ.Cluster.Deployments`). So nobody without the cookie can
  # write an entry that nodes accept. Nodes accept an entry only where it was written: not on another subject, not at
  # another position, and not in a later run that has the same name.
  #
  #   Follows   the number of the entry before it        Seal   nonce and MAC, in Base64
  #
  # Anybody who may delete entries can still take the whole log back to an earlier state: a seal proves who wrote an
  # entry, not that no entry came after it.
  alias Situ.Error
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @seal "Seal"
  @follows "Follows"

  @doc "Seals an entry that is to be written after number `follows` of a subject."
  @spec close(Entry.t(), String.t(), Log.subject(), non_neg_integer()) :: Entry.t()
  def close(%Entry{} = entry, run, subject, follows) do
    key = key(run)

    # The log takes entries of one name for the same write, so nobody else may be able to guess the next name.
    mark = :crypto.mac(:hmac, :sha256, key, context(subject, follows, entry.op, []))
    op = entry.op <> "." <> Base.encode16(binary_part(mark, 0, 8), case: :lower)
    head = entry.head |> Map.delete(@seal) |> Map.put(@follows, Integer.to_string(follows))
    nonce = :crypto.strong_rand_bytes(16)
    mac = mac(key, nonce, context(subject, follows, op, head), entry.data)
    %{entry | op: op, head: Map.put(head, @seal, Base.encode64(nonce <> mac)), verified: false}
  end

  @doc """
  Checks who wrote an entry that was read, and that it is at the position where it was written. The numbers of keys have
  gaps, so the position of a key's entry cannot be checked by the entry alone: `:behind` returns the number that the
  entry before it must have.
  """
  @spec open(Entry.t(), String.t(), Log.subject()) ::
          {:ok, Entry.t()} | {:behind, non_neg_integer(), Entry.t()} | {:error, Error.t()}
  def open(%Entry{head: head} = entry, run, subject) do
    with {:ok, nonce, mac} <- read_seal(head),
         follows when is_integer(follows) <- Entry.integer(entry, @follows, nil),
         signed = Map.delete(head, @seal),
         context = context(subject, follows, entry.op, signed),
         true <- :crypto.hash_equals(mac, mac(key(run), nonce, context, entry.data)) do
      entry = %{entry | head: Map.delete(signed, @follows), verified: true}
      check_position(entry, subject, follows)
    else
      :unsealed -> {:error, unsealed_error(entry, subject)}
      _ -> {:error, forged_error(entry, subject)}
    end
  end

  defp check_position(%{seq: seq} = entry, _subject, follows) when seq == follows + 1,
    do: {:ok, entry}

  defp check_position(%{seq: seq} = entry, {:key, _}, follows) when seq > follows,
    do: {:behind, follows, entry}

  defp check_position(entry, subject, _follows), do: {:error, moved_error(entry, subject)}

  defp read_seal(%{@seal => text}) do
    with {:ok, <<nonce::binary-16, mac::binary-16>>} <- Base.decode64(text),
         do: {:ok, nonce, mac},
         else: (_ -> :error)
  end

  defp read_seal(_head), do: :unsealed

  @doc "Encodes a term as the data of an entry, without a copy of large binaries."
  @spec encode_term(term()) :: iodata()
  def encode_term(term), do: :erlang.term_to_iovec(term)

  @doc "Decodes the term in an entry whose seal was checked, and refuses any other entry."
  @spec decode_term(Entry.t()) :: {:ok, term()} | {:error, Error.t()}
  def decode_term(%Entry{verified: true, data: data}),
    do: {:ok, data |> IO.iodata_to_binary() |> :erlang.binary_to_term()}

  def decode_term(%Entry{} = entry), do: {:error, forged_error(entry, nil)}

  @doc "Whether an error is the refusal of an entry by its seal."
  @spec refusal?(term()) :: boolean()
  def refusal?(%Error{code: code}), do: code in [:forged_entry, :unsealed_entry]
  def refusal?(_other), do: false

  @doc "Returns the error of an entry that was written elsewhere in the log, or earlier."
  @spec moved_error(Entry.t(), Log.subject()) :: Error.t()
  def moved_error(entry, subject) do
    refusal(:forged_entry, entry, "#{name(entry, subject)} is not where it was written",
      why: "somebody has copied it, written it once more, or deleted entries before it",
      fix: fix()
    )
  end

  defp forged_error(entry, subject) do
    refusal(
      :forged_entry,
      entry,
      "#{name(entry, subject)} does not have the seal of this deployment",
      why:
        "it was changed, or somebody else, a cluster with another cookie, or an earlier run has written it",
      fix: fix()
    )
  end

  defp unsealed_error(entry, subject) do
    refusal(:unsealed_entry, entry, "#{name(entry, subject)} has no seal",
      why:
        "an older version of Situ, which did not sign whole entries, or somebody else has written it",
      fix:
        "delete the entries of that version (`situ cluster prune NAME --log ADDRESS`), or give the cluster another log"
    )
  end

  defp refusal(code, entry, what, opts),
    do: Error.new(code, what, [meta: %{seq: entry.seq}] ++ opts)

  defp fix,
    do:
      "keep others from the log (`situ cluster init` makes credentials), then delete this deployment's entries" <>
        " (`situ cluster prune`) and deploy it again"

  defp name(entry, nil), do: "entry #{entry.seq}"
  defp name(entry, {kind, name}), do: "entry #{entry.seq} of the #{kind} #{name}"

  # Everything that is signed in addition to the data. No two entries give the same bytes.
  defp context({kind, name}, follows, op, head) do
    :erlang.term_to_binary({Atom.to_string(kind), name, follows, op, Enum.sort(head)},
      minor_version: 2
    )
  end

  # Poly1305 under a key that is used once: a seventh of what HMAC costs for a picture.
  defp mac(key, nonce, context, data) do
    state = :crypto.mac_init(:poly1305, :crypto.mac(:hmac, :sha256, key, nonce))
    state = :crypto.mac_update(state, [<<byte_size(context)::64>>, context])
    pieces = :erlang.iolist_to_iovec(data)
    :crypto.mac_final(Enum.reduce(pieces, state, &:crypto.mac_update(&2, &1)))
  end

  # Computed each time, so that no process and no crash report contains it.
  defp key(run) do
    cookie = :crypto.hash(:sha256, ["situ log 2 ", Atom.to_string(Node.get_cookie())])
    :crypto.mac(:hmac, :sha256, cookie, run)
  end

  @doc "Returns a name of this cluster that does not reveal its cookie."
  @spec cluster_name() :: String.t()
  def cluster_name,
    do: "name" |> key() |> binary_part(0, 8) |> Base.encode16(case: :lower)
end
