"""From a configuration to a running bridge: engine, sources, sinks, recorder, and their end in order."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

from bridge.clock import Clock, WallClock
from bridge.config import Config
from bridge.engine import Engine
from bridge.errors import ConfigError, SourceError
from bridge.live import Bench, Live, Sink
from bridge.realtime import no_collections
from bridge.recording import Recorder
from bridge.sinks import SINKS, SinkContext
from bridge.sources import SOURCES, Source, SourceContext


def make_sinks(config: Config, engine: Engine) -> list[Sink]:
    """Every sink of ``config``; raises ConfigError where one cannot do what it is asked."""
    sinks = []
    for name, options in config.sinks.items():
        number = config.source_number(options.source)
        context = SinkContext(name, number, engine.peers.get(number), config.files, config.contract)
        sinks.append(SINKS[options.type].factory(options, context))
    return sinks


def make_sources(config: Config, engine: Engine, clock: Clock, wall: WallClock) -> list[Source]:
    """Every source of ``config``, none of them open; raises ConfigError where one cannot be."""
    sources = []
    for number, (name, options) in enumerate(config.sources.items(), start=1):
        accept, secret = engine.accept.get(number), config.keys.get(name)
        context = SourceContext(number, name, clock, wall, accept, secret)
        try:
            sources.append(SOURCES[options.type](options, context))
        except ConfigError as error:
            raise ConfigError(f"{config.file}: source.{name}.{error}") from error
    return sources


class Bridge:
    """Everything one configuration needs, on one clock. A context manager that opens and closes it.

    The engine is built before any bus is opened; from then on there are no garbage collections. With
    ``out`` a capture is written; ``lossless`` lets the loop wait for the disk (simulated time only),
    ``metadata`` is added to it.

    Raises ConfigError, SourceError or CaptureError with the reason.
    """

    def __init__(
        self,
        config: Config,
        clock: Clock,
        *,
        out: str | Path | None = None,
        lossless: bool = False,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self.config = config
        self.clock = clock
        self.wall = WallClock(clock)
        self.engine = Engine(config)
        self.sources: list[Source] = []
        self.sinks: list[Sink] = []
        self.recorder: Recorder | None = None
        self._out = out
        self._lossless = lossless
        self._metadata = dict(metadata or {})
        self._stack = ExitStack()

    def __enter__(self) -> Bridge:
        with ExitStack() as stack:
            self.sinks = make_sinks(self.config, self.engine)
            self.sources = make_sources(self.config, self.engine, self.clock, self.wall)
            if self._out is not None:
                self.recorder = self._recorder(self._out)
                stack.callback(self.recorder.close)
            stack.enter_context(no_collections())
            # last, so that nothing piles up in their buffers meanwhile
            for source in self.sources:
                self._open(source)
                stack.callback(source.close)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def live(
        self,
        *,
        bench: Bench | None = None,
        sources: Sequence[Source] = (),
        sinks: Sequence[Sink] = (),
    ) -> Live:
        """The loop over these parts; ``sources`` and ``sinks`` come on top of the configured ones."""
        return Live(
            engine=self.engine,
            sources=[*self.sources, *sources],
            sinks=[*self.sinks, *sinks],
            clock=self.clock,
            wall=self.wall,
            recorder=self.recorder,
            bench=bench,
        )

    def _open(self, source: Source) -> None:
        try:
            source.open()
        except SourceError:
            if self.recorder is not None:  # nothing will be in it
                self.recorder.path.unlink(missing_ok=True)
            raise

    def _recorder(self, path: str | Path) -> Recorder:
        filters = {source.context.name: source.filters() for source in self.sources}
        return Recorder(
            path,
            sources={0: "bridge", **{source.context.number: source.context.name for source in self.sources}},
            utc_offset_ns=self.wall.offset_ns,
            attachments=self.config.attachments(),
            metadata={"filters": json.dumps(filters), **self._metadata},
            lossless=self._lossless,
        )
