defmodule Situ.Infer.PropertyTest do
  use ExUnit.Case, async: true
  import Situ.Test.Property, only: [property: 2]

  alias Situ.Infer.{FaceTracker, SimpleVad, VoiceGate}
  alias Situ.Rect

  property "a gate decides every span once, in order, and never later than it may" do
    {
      {:proper_types.list(:proper_types.float(0.0, 1.0)), :proper_types.range(0, 60),
       :proper_types.range(0, 60)},
      fn {ps, min_speech, min_silence} ->
        gate = VoiceGate.new(min_speech: min_speech, min_silence: min_silence)

        {events, gate} =
          ps
          |> Enum.with_index(1)
          |> Enum.flat_map_reduce(gate, fn {p, i}, gate ->
            {out, gate} = VoiceGate.push(gate, i * 10, 10, p)
            {Enum.map(out, &{i * 10, &1}), gate}
          end)

        {last, _} = VoiceGate.close(gate)
        now = length(ps) * 10
        all = events ++ Enum.map(last, &{now, &1})
        times = for {_, {t, v}} <- all, is_boolean(v), do: t
        late = for {at, {t, v}} <- all, is_boolean(v), do: at - t

        # Unsure speech may last as long as the first, the pause in it as long as the second.
        times == Enum.map(1..length(ps)//1, &(&1 * 10)) and
          Enum.all?(
            late,
            &(&1 <= min_speech + min_silence + 20)
          )
      end
    }
  end

  property "the simple detector decides every value once, in order" do
    {:proper_types.list(:proper_types.range(0, 14)),
     fn values ->
       {out, vad} =
         values
         |> Enum.with_index()
         |> Enum.flat_map_reduce(SimpleVad.new(window: 25), fn {v, i}, vad ->
           SimpleVad.push(vad, i * 10, v)
         end)

       {last, _} = SimpleVad.close(vad)
       times = Enum.map(out ++ last, &elem(&1, 0))
       times == Enum.map(0..(length(values) - 1)//1, &(&1 * 10))
     end}
  end

  property "a tracker gives every face of a picture an id of its own" do
    picture = :proper_types.list({:proper_types.range(0, 200), :proper_types.range(1, 40)})

    {:proper_types.list(picture),
     fn pictures ->
       {ok, _} =
         pictures
         |> Enum.with_index()
         |> Enum.map_reduce(FaceTracker.new(), fn {faces, i}, tracker ->
           faces =
             for {x, w} <- faces,
                 do: %Situ.Infer.Face{rect: Rect.new!(x, 0, w, w), eyes: {{0, 0}, {1, 0}}}

           {tracked, tracker} = FaceTracker.step(tracker, i * 40_000_000, faces)
           ids = Enum.map(tracked, & &1.rect.id)
           {length(tracked) == length(faces) and Enum.uniq(ids) == ids, tracker}
         end)

       Enum.all?(ok)
     end}
  end
end
