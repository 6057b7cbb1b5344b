# Replays the demo's recording through the real graph: audio through voice activity, images
# through face and mouth, and both through the fusion that determines the speaker. At 1x, at 4x
# and at full speed, the derived streams must have the same bytes, and the results for audio and
# mouths must equal those recorded live.
#
#     replay.exs STORE_FOLDER
alias Situ.{Pipeline, Store, Time}

{:ok, _} = Application.ensure_all_started(:situ_examples)
[folder] = System.argv()
path = hd(Store.list(folder))
store = Store.open!(path)
{:ok, %{first: start}} = Store.stream_info(store, "Talk.Pictures")
test = self()

collect = fn stream, name ->
  Situ.each(stream, fn data, m ->
    send(test, {name, {m.originating_time, m.sequence_id, data}})
  end)
end

received = fn received, name, got ->
  receive do
    {^name, message} -> received.(received, name, [message | got])
  after
    0 -> Enum.reverse(got)
  end
end

replay = fn names, settings, build ->
  {:ok, _} = Pipeline.run(build, pipeline: [replay: settings])
  for name <- names, into: %{}, do: {name, received.(received, name, [])}
end

# Uses the recorded lips, which is fast enough for the entire clip.
from_mouths = fn p ->
  talk = Store.importer(p, path)
  voice = talk |> Store.stream("Talk.Sound") |> Situ.Infer.voice()
  collect.(voice, :voice)
  collect.(Situ.Infer.who_speaks(Store.stream(talk, "Talk.Mouths"), voice), :speaking)
end

# Uses audio and images.
from_pictures = fn p ->
  talk = Store.importer(p, path)
  voice = talk |> Store.stream("Talk.Sound") |> Situ.Infer.voice()

  lips =
    talk
    |> Store.stream("Talk.Pictures")
    |> Situ.ImageStream.decode()
    |> Situ.Infer.MouthShape.detect_stages()

  collect.(lips.mouths, :mouths)
  collect.(Situ.Infer.who_speaks(lips.mouths, voice), :speaking)
end

same! = fn what, a, b ->
  for {name, messages} <- a do
    if messages == [], do: raise("#{what}: no #{name}")

    if :erlang.term_to_binary(messages) != :erlang.term_to_binary(b[name]),
      do: raise("#{what}: #{name} differs")

    IO.puts("#{what}: #{name}, #{length(messages)} messages, equal")
  end
end

whole = replay.([:voice, :speaking], [speed: :max], from_mouths)

recorded =
  for {name, stream} <- [voice: "Talk.Voice", speaking: "Talk.Speaking"], into: %{} do
    {name,
     for(m <- Store.messages(store, stream), do: {m.originating_time, m.sequence_id, m.data})}
  end

same!.("as fast as it goes, and live", whole, recorded)

same!.(
  "4x, and as fast as it goes",
  replay.([:voice, :speaking], [speed: 4.0], from_mouths),
  whole
)

section = {start + Time.s(2), start + Time.s(4)}
settings = fn speed -> [speed: speed, interval: section] end
fast = replay.([:mouths, :speaking], settings.(:max), from_pictures)

for speed <- [1.0, 4.0] do
  same!.(
    "#{speed}x from pictures",
    replay.([:mouths, :speaking], settings.(speed), from_pictures),
    fast
  )
end

true = fast.speaking |> Enum.flat_map(&Map.values(elem(&1, 2))) |> Enum.member?(true)
IO.puts("somebody speaks in the section")
