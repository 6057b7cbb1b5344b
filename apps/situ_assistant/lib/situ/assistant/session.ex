defmodule Situ.Assistant.Session do
  @moduledoc false
  # The pipeline of `situ talk`: an assistant (`Situ.Assistant`) that listens to a microphone or a
  # file. Its options are:
  #
  # | option | meaning |
  # |---|---|
  # | `:input` | the name of a microphone, the path of a file, or a function that opens audio in a pipeline |
  # | `:output` | the name of a speaker, a function that plays a stream of audio, or `nil` |
  # | `:path` | the folder of the recording |
  # | `:assistant` | the options of `Situ.Assistant.attach/2` |
  # | `:watcher` | a process that receives `{:talk, key, data, time, creation_time}` for each event, or `nil` |
  #
  # Everything is recorded. The recording, `path/Assistant.NNNN`, contains the input audio and the
  # spoken audio, voice activity, the recognized text (partial and final), the intents, the
  # replies, and the pipeline's diagnostics.
  use Situ.Pipeline
  alias Situ.Media.{Microphone, Speaker, VideoFile}

  @format Situ.AudioFormat.pcm(16_000)

  @impl true
  def build(p, opts) do
    sound = open_audio(p, opts[:input])
    assistant = Situ.Assistant.attach(sound, opts[:assistant])
    play_speech(assistant.sound, opts[:output])

    store = Situ.Store.create(p, "Assistant", opts[:path])

    record = fn stream, name ->
      stream && Situ.Store.write(stream, store, "Assistant." <> name)
    end

    record.(sound, "Heard.Sound")
    record.(assistant.voice, "Heard.Voice")
    record.(assistant.heard, "Heard.Utterance")
    record.(assistant.partial, "Heard.Partial")
    record.(to_text(assistant.heard), "Heard.Text")
    record.(assistant.intent, "Intent")
    record.(assistant.said, "Said.Text")
    record.(assistant.chat, "Said.Chat")
    record.(assistant.sound, "Said.Sound")
    record.(assistant.speaking, "Said.Speaking")
    record.(assistant.stop, "Interrupted")
    record.(Situ.Diagnostics.stream(p), "Diagnostics")

    watch_streams(Map.put(assistant, :listening, Situ.first(assistant.voice)), opts[:watcher])
    store
  end

  defp open_audio(p, open) when is_function(open, 1), do: open.(p)

  defp open_audio(p, input) do
    if File.regular?(input),
      do:
        require_audio!(VideoFile.open(p, input, video: false, audio_format: @format).audio, input),
      else: Microphone.open(p, device: input, audio_format: @format, name: "Microphone")
  end

  defp play_speech(_sound, nil), do: :ok
  defp play_speech(sound, play) when is_function(play, 1), do: play.(sound)
  defp play_speech(sound, device), do: Speaker.play(sound, device: device, name: "Speaker")

  defp require_audio!(nil, input) do
    raise Situ.Error.new(:no_sound, "#{input} has no audio",
            fix: "name a file with audio, or a microphone"
          )
  end

  defp require_audio!(stream, _input), do: stream

  defp to_text(heard), do: Situ.map(heard, & &1.text, type: :string, name: "Text")

  defp watch_streams(_assistant, nil), do: :ok

  defp watch_streams(assistant, watcher) do
    for key <- [:listening, :heard, :intent, :said, :chat, :speaking, :stop],
        stream = assistant[key] do
      Situ.each(stream, &send(watcher, {:talk, key, &1, &2.originating_time, &2.creation_time}))
    end
  end
end
