defmodule Situ.Cluster.SignedEntry do
  @moduledoc false
  # Signs and verifies complete entries of the log: subject, position, name, head and data. The key is derived from the
  # cluster's cookie and the run of a deployment (`Situ.Cluster.Deployments`). Without the cookie, nobody can write an
  # entry that nodes accept. Nodes accept an entry only at the position where it was written: not on another subject,
  # not at another position, and not in a later run with the same name.
  #
  # The head of an entry has two fields for this: `Follows` is the number of the entry before it, and `Seal` is a nonce
  # and a MAC in Base64.
  #
  # Anybody who can delete entries can still reset the whole log to an earlier state. A seal proves who wrote an entry,
  # but not that no other entry came after it.
  # See docs/adr/0119-log-entries-are-sealed-with-their-position.md.
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @seal "Seal"
  @follows "Follows"

  @doc "Seals an entry that will be written after number `follows` of a subject."
  @spec seal_entry(Entry.t(), String.t(), Log.subject(), non_neg_integer()) :: Entry.t()
  def seal_entry(%Entry{} = entry, run, subject, follows) do
    key = run_key(run)

    # The log treats entries with the same name as the same write, so nobody else may be able to guess the next name.
    mark = :crypto.mac(:hmac, :sha256, key, signed_context(subject, follows, entry.op, []))
    op = entry.op <> "." <> Base.encode16(binary_part(mark, 0, 8), case: :lower)
    head = entry.head |> Map.delete(@seal) |> Map.put(@follows, Integer.to_string(follows))
    nonce = :crypto.strong_rand_bytes(16)
    mac = compute_mac(key, nonce, signed_context(subject, follows, op, head), entry.data)
    %{entry | op: op, head: Map.put(head, @seal, Base.encode64(nonce <> mac)), verified: false}
  end

  @doc """
  Verifies who wrote an entry, and that it is at the position where it was written. The numbers of a key's entries have
  gaps, so their position cannot be verified from the entry alone. In that case, returns `:behind` with the number that
  the previous entry must have.
  """
  @spec verify_entry(Entry.t(), String.t(), Log.subject()) ::
          {:ok, Entry.t()} | {:behind, non_neg_integer(), Entry.t()} | {:error, Error.t()}
  def verify_entry(%Entry{head: head} = entry, run, subject) do
    with {:ok, nonce, mac} <- read_seal(head),
         follows when is_integer(follows) <- Entry.head_integer(entry, @follows, nil),
         signed = Map.delete(head, @seal),
         context = signed_context(subject, follows, entry.op, signed),
         true <- :crypto.hash_equals(mac, compute_mac(run_key(run), nonce, context, entry.data)) do
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

  @doc "Decodes the term in an entry whose seal was verified; returns an error for any other entry."
  @spec decode_term(Entry.t()) :: {:ok, term()} | {:error, Error.t()}
  def decode_term(%Entry{verified: true, data: data}),
    do: {:ok, data |> IO.iodata_to_binary() |> :erlang.binary_to_term()}

  def decode_term(%Entry{} = entry), do: {:error, forged_error(entry, nil)}

  @doc "Returns whether an error means that an entry was rejected because of its seal."
  @spec refusal?(term()) :: boolean()
  def refusal?(%Error{code: code}), do: code in [:forged_entry, :unsealed_entry]
  def refusal?(_other), do: false

  @doc "Returns the error for an entry that was written elsewhere in the log, or earlier."
  @spec moved_error(Entry.t(), Log.subject()) :: Error.t()
  def moved_error(entry, subject) do
    refusal_error(
      :forged_entry,
      entry,
      "#{entry_name(entry, subject)} is not where it was written",
      why: "somebody has copied it, written it again, or deleted entries before it",
      fix: fix_text()
    )
  end

  defp forged_error(entry, subject) do
    refusal_error(
      :forged_entry,
      entry,
      "#{entry_name(entry, subject)} does not have the seal of this deployment",
      why:
        "it was changed, or was written by somebody else, by a cluster with another cookie, or in an earlier run",
      fix: fix_text()
    )
  end

  defp unsealed_error(entry, subject) do
    refusal_error(:unsealed_entry, entry, "#{entry_name(entry, subject)} has no seal",
      why:
        "it was written by an older version of Situ, which did not sign complete entries, or by somebody else",
      fix:
        "delete the entries of that version (`situ cluster prune NAME --log ADDRESS`), or use another log"
    )
  end

  defp refusal_error(code, entry, what, opts),
    do: Error.new(code, what, [meta: %{seq: entry.seq}] ++ opts)

  defp fix_text,
    do:
      "restrict access to the log (`situ cluster init` creates credentials), then delete this deployment's entries" <>
        " (`situ cluster prune`) and deploy it again"

  defp entry_name(entry, nil), do: "entry #{entry.seq}"
  defp entry_name(entry, {kind, name}), do: "entry #{entry.seq} of the #{kind} #{name}"

  # Returns the bytes that are signed in addition to the data. They are different for any two entries.
  defp signed_context({kind, name}, follows, op, head) do
    :erlang.term_to_binary({Atom.to_string(kind), name, follows, op, Enum.sort(head)},
      minor_version: 2
    )
  end

  # Poly1305 with a one-time key takes a seventh of the time of HMAC for an image.
  defp compute_mac(key, nonce, context, data) do
    state = :crypto.mac_init(:poly1305, :crypto.mac(:hmac, :sha256, key, nonce))
    state = :crypto.mac_update(state, [<<byte_size(context)::64>>, context])
    chunks = :erlang.iolist_to_iovec(data)
    :crypto.mac_final(Enum.reduce(chunks, state, &:crypto.mac_update(&2, &1)))
  end

  # The key is computed each time, so that no process state and no crash report contains it.
  defp run_key(run) do
    cookie = :crypto.hash(:sha256, ["situ log 2 ", Atom.to_string(Node.get_cookie())])
    :crypto.mac(:hmac, :sha256, cookie, run)
  end

  @doc "Returns a name for this cluster that does not reveal its cookie."
  @spec cluster_name() :: String.t()
  def cluster_name,
    do: "name" |> run_key() |> binary_part(0, 8) |> Base.encode16(case: :lower)
end
